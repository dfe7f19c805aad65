// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/key.hpp>

namespace loopwise {

/// Points of a lidar scan in the body frame of its node, metres. All finite.
struct PointCloud {
  std::vector<Eigen::Vector3f> points;   ///< Coordinates relative to `origin`, m.
  std::vector<Eigen::Vector3f> normals;  ///< Unit length, towards the sensor. Empty, or one per point.
  std::vector<float> intensities;        ///< Empty, or one per point.
  /// Origin of the coordinates in the frame of the cloud, m; axes are parallel. Zero for the scans of nodes.
  /// Clouds in world coordinates have an origin near their points: a float resolves 0.5 m at 5000 km.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();

  /// Number of points.
  [[nodiscard]] std::size_t size() const { return points.size(); }
  /// Whether there is no point.
  [[nodiscard]] bool empty() const { return points.empty(); }
  /// Whether every point has a normal.
  [[nodiscard]] bool has_normals() const { return !points.empty() && normals.size() == points.size(); }
  /// Memory of the points, for bounded caches.
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + points.capacity() * sizeof(points[0]) + normals.capacity() * sizeof(points[0]) +
           intensities.capacity() * sizeof(float);
  }
};

/// The cloud of a key frame. Cheap to copy: the points are shared and never change.
struct KeyedScan {
  Key key = 0;                              ///< The node.
  std::int64_t stamp_ns = 0;                ///< Time of the sweep, ns since the epoch of the recording.
  std::shared_ptr<const PointCloud> cloud;  ///< In the body frame of the node; null if it was not stored.
};

/// Returns the scan of a node, or null if it has no scan. Must be safe to call from several threads; may
/// throw InputError or IoError if the scan exists but cannot be read.
using ScanLoader = std::function<std::shared_ptr<const PointCloud>(Key)>;

}  // namespace loopwise
