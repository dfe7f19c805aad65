// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// How much two scans will overlap, told before they are registered.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

/// The rough shape of a scan, in at most 8 kB: which voxels of a grid have points, and points drawn from
/// them. The voxels are as large as the sensor's surroundings are wide: 0.4 m in a small room, 3 m outdoors.
/// Points that are not finite are left out. O(n), about 0.05 ms for a sweep of 64 000 points.
class LOOPWISE_EXPORT ScanSignature {
 public:
  /// Of no scan: empty.
  ScanSignature() = default;
  /// Of a scan in its body frame, downsampled or not.
  explicit ScanSignature(const PointCloud& cloud);

  /// Nothing is known: there was no scan, or it has no points.
  [[nodiscard]] bool empty() const { return points_ == 0; }
  /// Edge of the voxels, m.
  [[nodiscard]] double voxel_m() const { return static_cast<double>(voxel_m_); }
  /// Points that were drawn.
  [[nodiscard]] std::size_t points() const { return points_; }
  /// Share of the points of `other` that lie in voxels of this scan, in [0, 1]; 0 if one of them is empty.
  /// \param other the other scan
  /// \param T_this_other pose of the other scan's frame in the frame of this one
  [[nodiscard]] double share_of(const ScanSignature& other, const Eigen::Isometry3d& T_this_other) const;
  /// Memory that the signature holds.
  [[nodiscard]] std::size_t bytes() const { return sizeof(*this) + bits_.capacity() * sizeof(bits_[0]); }

  /// All of it as words, and back. For recorded runs.
  [[nodiscard]] std::vector<std::uint32_t> words() const;
  /// What words() gave. \throws InputError
  [[nodiscard]] static ScanSignature from_words(const std::vector<std::uint32_t>& words);

 private:
  static constexpr std::size_t kPoints = 200;

  float voxel_m_ = 0.0F;
  std::array<float, 3> low_{};  // corner of the grid, m
  std::array<std::int32_t, 3> size_{};
  std::vector<std::uint32_t> bits_;
  std::uint32_t points_ = 0;
  std::array<std::array<float, kPoints>, 3> drawn_{};  // x, y and z
};

/// The smaller of the shares that two scans see of each other, in [0, 1].
/// \param from one of the scans
/// \param to the other scan
/// \param T_from_to pose of the scan `to` in the frame of `from`, as guessed
[[nodiscard]] LOOPWISE_EXPORT double predicted_overlap(const ScanSignature& from, const ScanSignature& to,
                                                       const Eigen::Isometry3d& T_from_to);

}  // namespace loopwise
