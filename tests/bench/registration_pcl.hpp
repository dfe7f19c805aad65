// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// PCL's registration in its own classes, each stage timed: the peer of the benchmark.
#pragma once

#include <cstddef>
#include <memory>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>

namespace loopwise::bench {

/// Processor time of this thread, s.
[[nodiscard]] double thread_seconds();

/// What PCL needs of a scan, computed once, with the milliseconds that each step took.
class PclScan {
 public:
  PclScan(const PointCloud& cloud, double voxel_m, double fpfh_radius_m);
  ~PclScan();
  struct Impl;
  std::unique_ptr<Impl> impl;
  std::size_t points = 0, harris_points = 0;
  double voxel_ms = 0, normals_ms = 0, harris_ms = 0, fpfh_ms = 0, fpfh_harris_ms = 0;
};

struct PclAlignment {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  double sac_ms = 0, gicp_ms = 0;
  bool accepted = false;  ///< By the bounds of 32 m² after the first stage and 0.9 m² after the second.
  [[nodiscard]] double ms() const { return sac_ms + gicp_ms; }
};

/// SampleConsensusInitialAlignment with 500 hypotheses over all points or over Harris key points, then
/// GeneralizedIterativeClosestPoint. Search structures, descriptors and covariances are there already.
[[nodiscard]] PclAlignment pcl_align(const PclScan& source, const PclScan& target, bool harris,
                                     unsigned seed);

struct PclGicpSettings {
  double reach_m = 1.0;
  double translation_epsilon = 5e-4;
  double rotation_epsilon = 2e-3;
  bool own_covariances = false;  ///< Computed by PCL within the time, from 20 neighbours.
};

/// The second stage alone; the fields of the first are 0.
[[nodiscard]] PclAlignment pcl_gicp(const PclScan& source, const PclScan& target,
                                    const Eigen::Isometry3d& start, const PclGicpSettings& settings);

}  // namespace loopwise::bench
