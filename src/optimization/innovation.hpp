// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise::detail {

/// How far each closure lies from what the known inliers alone say, before anything is solved: d² = rᵀS⁻¹r,
/// with r the residual at poses chained along odometry and S the closure's covariance plus that of the chain
/// between its ends, carried along to first order. A true closure's d² has six degrees of freedom if the
/// information is honest. One value per edge in graph order; NaN for known inliers and where no chain of
/// known inliers and priors joins the ends.
[[nodiscard]] std::vector<double> innovations(const PoseGraph& graph);

}  // namespace loopwise::detail
