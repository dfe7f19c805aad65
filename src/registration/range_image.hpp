// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

/// The range that a sensor at the origin measured in each direction, on a grid of 4° by 4°. The space up to
/// this range is free. Each cell keeps the nearest point of three by three cells, so that the space beside an
/// edge does not count as free.
class RangeImage {
 public:
  RangeImage() = default;
  explicit RangeImage(const PointCloud& cloud);

  /// Share of points that are in free space by more than 0.5 m and 5 % of the range, among the points in
  /// directions with a measurement. Uses at most `count` points, evenly sampled. 0 for a scan without points.
  [[nodiscard]] double contradiction(const PointCloud& cloud, const Eigen::Isometry3d& T_sensor_cloud,
                                     std::size_t count) const;

  /// The same share of the scan's own points, each against the image of all others: high for sparse scans of
  /// rough surfaces, where free space between the points is a guess. A point also counts if the others have
  /// seen something in a cell beside its own only: in sparse scans, few cells hold two points.
  [[nodiscard]] double own_contradiction() const { return own_contradiction_; }

  [[nodiscard]] std::size_t bytes() const { return sizeof(*this) + free_m_.capacity() * sizeof(float); }

 private:
  std::vector<float> free_m_;  // by cell; infinite where nothing was seen
  std::vector<char> seen_;     // whether the cell itself holds a point
  double own_contradiction_ = 0.0;
};

}  // namespace loopwise
