// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// One pass of the refinement: the reach of matches, the source points, and when it ends.
struct GicpPass {
  double reach_m = 0.5;
  std::size_t points = 0;  ///< Number of points from the start of the order; 0 for all.
  int iterations = 20;
  double translation_step_m = 1e-3;
  double rotation_step_rad = 1e-4;
};

/// From coarse to fine: the reach shrinks with few points, then the last pass refines with more points.
[[nodiscard]] std::vector<GicpPass> gicp_passes(double coarse_reach_m, double fine_reach_m,
                                                std::size_t coarse_points, std::size_t fine_points);

struct GicpResult {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  bool converged = false;  ///< The last step was within five times the bounds at which the pass ends.
  int iterations = 0;
};

/// Generalized ICP (Segal, Haehnel, Thrun, RSS 2009) with covariances from normals, by Gauss-Newton with
/// analytic Jacobians and a Geman-McClure kernel of a third of the reach. `order` lists the source points
/// that take part. Steps rotate about `source_centre`, so that clouds far from the origin keep their digits.
[[nodiscard]] GicpResult refine_gicp(const PointCloud& source, const Eigen::Vector3d& source_centre,
                                     const std::vector<std::uint32_t>& order, const PointCloud& target,
                                     const KdTree& target_tree, const Eigen::Isometry3d& start,
                                     const std::vector<GicpPass>& passes);

}  // namespace loopwise
