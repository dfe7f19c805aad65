// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Prediction of the overlap of two scans before registration.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

/// The rough shape of a scan, in at most 8 kB: the occupied voxels of a grid, and points drawn from them. The
/// size of the voxels is proportional to the width of the surroundings: 0.4 m in a small room, 3 m outdoors.
/// Points that are not finite are left out. O(n), about 0.05 ms for a sweep of 64 000 points.
class LOOPWISE_EXPORT ScanSignature {
 public:
  /// The empty signature, of no scan.
  ScanSignature() = default;
  /// The signature of a scan in its body frame, downsampled or not.
  explicit ScanSignature(const PointCloud& cloud);

  /// Whether the signature is empty: no scan, or a scan without points.
  [[nodiscard]] bool empty() const { return points_ == 0; }
  /// Edge of the voxels, m.
  [[nodiscard]] double voxel_m() const { return static_cast<double>(voxel_m_); }
  /// Number of drawn points.
  [[nodiscard]] std::size_t points() const { return points_; }
  /// Share of the points of `other` in voxels of this scan, in [0, 1]; 0 if one of them is empty.
  /// \param other the other scan
  /// \param T_this_other pose of the other scan's frame in the frame of this one
  [[nodiscard]] double share_of(const ScanSignature& other, const Eigen::Isometry3d& T_this_other) const;
  /// Memory that the signature holds.
  [[nodiscard]] std::size_t bytes() const { return sizeof(*this) + bits_.capacity() * sizeof(bits_[0]); }

  /// The signature as words, for recorded runs.
  [[nodiscard]] std::vector<std::uint32_t> words() const;
  /// The signature from words(). \throws InputError
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

/// The smaller of the shares of two scans in each other, in [0, 1].
/// \param from one of the scans
/// \param to the other scan
/// \param T_from_to guessed pose of the scan `to` in the frame of `from`
[[nodiscard]] LOOPWISE_EXPORT double predicted_overlap(const ScanSignature& from, const ScanSignature& to,
                                                       const Eigen::Isometry3d& T_from_to);

}  // namespace loopwise
