// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/registration/gicp.hpp>

#include "followed_points.hpp"

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

/// The refinement of gicp() by these passes, without its checks: a Gauss-Newton method whose kernel is a
/// third of the reach. `order` lists the source points that take part. Steps rotate about `source_centre`, so
/// that clouds far from the origin keep their digits. `followed` are these points and the target's tree; the
/// next refinement of the same points may use them again.
[[nodiscard]] GicpResult refine_gicp(const PointNormalView& source, const Eigen::Vector3d& source_centre,
                                     const std::vector<std::uint32_t>& order, const PointNormalView& target,
                                     FollowedPoints& followed, const Eigen::Isometry3d& start,
                                     const std::vector<GicpPass>& passes);

}  // namespace loopwise
