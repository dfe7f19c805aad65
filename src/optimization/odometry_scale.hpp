// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "odometry_forest.hpp"
#include "pose_problem.hpp"

namespace loopwise::detail {

/// Variance factors of odometry by the root of its tree: how many times its true covariance is the stated
/// one. A tree that is not there has 1.
using OdometryVariances = std::map<std::uint32_t, double>;

/// The graph with the information of its odometry divided by the variance factors.
[[nodiscard]] PoseGraph with_odometry_variances(const PoseGraph& graph, const OdometryForest& forest,
                                                const OdometryVariances& variances);

/// Estimates variance factors from the minimum of a graph, by the redundancy of its odometry (variance
/// component estimation, Förstner 1979): of the tree's edges s² = Σ rᵀΩr / Σ (6 − tr(Ω J Σ Jᵀ)). Trees with
/// what the stated information explains keep 1, and none has less, or more than `largest`. \param graph with
/// the information `variances` were applied to \param weights by edge, of the minimum
[[nodiscard]] OdometryVariances odometry_variances(const PoseGraph& graph, const OdometryForest& forest,
                                                   const std::vector<Eigen::Isometry3d>& poses,
                                                   const std::vector<double>& weights,
                                                   const OdometryVariances& variances, double largest);

}  // namespace loopwise::detail
