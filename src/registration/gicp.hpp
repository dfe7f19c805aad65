// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// One pass of the refinement: how far matches reach, which source points take part, when it ends.
struct GicpPass {
  double reach_m = 0.5;
  std::size_t points = 0;  ///< The first so many of the order; 0 takes all.
  int iterations = 20;
  double translation_step_m = 1e-3;
  double rotation_step_rad = 1e-4;
};

/// From coarse to fine: the reach shrinks while few points take part, then all of them settle the pose.
[[nodiscard]] std::vector<GicpPass> gicp_passes(double coarse_reach_m, double fine_reach_m,
                                                std::size_t coarse_points, std::size_t fine_points);

struct GicpResult {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  bool converged = false;  ///< The last step was within five times the bounds at which the pass ends.
  int iterations = 0;
};

/// Generalized ICP (Segal, Haehnel, Thrun, RSS 2009) with covariances from normals, by Gauss-Newton with
/// analytic Jacobians and a Geman-McClure kernel of a third of the reach. `order` lists the source points
/// that take part; the steps turn about `source_centre`, which keeps the digits of far-away clouds.
[[nodiscard]] GicpResult refine_gicp(const PointCloud& source, const Eigen::Vector3d& source_centre,
                                     const std::vector<std::uint32_t>& order, const PointCloud& target,
                                     const KdTree& target_tree, const Eigen::Isometry3d& start,
                                     const std::vector<GicpPass>& passes);

}  // namespace loopwise
