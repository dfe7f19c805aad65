// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The refinement of small_gicp (Koide, JOSS 2024), where the build has found that library: a peer of the
/// benchmark.
#pragma once

#include <memory>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>

namespace loopwise::bench {

/// Whether this build has small_gicp. Without it, the classes below do nothing.
[[nodiscard]] bool has_small_gicp();

/// What small_gicp needs of a scan, computed once: voxels, covariances of 10 neighbours, a tree, and Gaussian
/// voxels of 1 m.
class SmallGicpScan {
 public:
  SmallGicpScan(const PointCloud& cloud, double voxel_m);
  ~SmallGicpScan();
  struct Impl;
  std::unique_ptr<Impl> impl;
};

struct SmallGicpAlignment {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  double ms = 0.0;  ///< Processor time of this thread.
  bool converged = false;
};

/// One thread, the library's default settings. \param voxels VGICP in place of GICP
[[nodiscard]] SmallGicpAlignment small_gicp_align(const SmallGicpScan& source, const SmallGicpScan& target,
                                                  const Eigen::Isometry3d& start, bool voxels);

}  // namespace loopwise::bench
