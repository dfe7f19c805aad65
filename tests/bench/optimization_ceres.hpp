// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise::bench {

struct CeresOutcome {
  double cost = 0.0;
  int iterations = 0;
  std::vector<Eigen::Isometry3d> poses;
};

/// The same problem in Ceres: sparse normal Cholesky on SuiteSparse, analytic Jacobians on the same tangent
/// space, Levenberg-Marquardt with its defaults, until the cost settles to 1e-10. One thread.
[[nodiscard]] CeresOutcome ceres_optimize(const PoseGraph& graph);

/// All 6×6 marginal blocks by ceres::Covariance (SuiteSparse QR) at the graph's poses. \returns their trace,
/// or a negative number if it fails.
[[nodiscard]] double ceres_marginal_trace(const PoseGraph& graph);

}  // namespace loopwise::bench
