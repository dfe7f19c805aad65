// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise::detail {

/// Of every node the first node of its chain, which is what edges of kind odometry join. It stays the same
/// while a graph grows, unless new odometry joins two chains.
[[nodiscard]] std::vector<std::uint32_t> odometry_chains(const PoseGraph& graph);

/// Variance factors of odometry by the first node of its chain: how many times its true covariance is the
/// stated one. A chain that is not there has 1.
using OdometryVariances = std::map<std::uint32_t, double>;

/// The graph with the information of its odometry divided by the variance factors.
[[nodiscard]] PoseGraph with_odometry_variances(const PoseGraph& graph,
                                                const std::vector<std::uint32_t>& chains,
                                                const OdometryVariances& variances);

/// Estimates variance factors at the minimum that a graph has with other ones, by the redundancy of the
/// chains (variance component estimation, Förstner 1979): s² = Σ rᵀΩr / Σ (d − tr(Ω J Σ Jᵀ)) over a chain's
/// edges, with d degrees of freedom each. Edges of singular information are left out. Chains that their
/// stated information explains have 1, as have those that nothing else measures, and none has less, or more
/// than `largest`. \param graph as stated \param variances of the minimum \param weights by edge, of the
/// minimum \returns nothing where the factors leave a pose open: there are no covariances
[[nodiscard]] std::optional<OdometryVariances> estimated_odometry_variances(
    const PoseGraph& graph, const std::vector<std::uint32_t>& chains,
    const std::vector<Eigen::Isometry3d>& poses, const std::vector<double>& weights,
    const OdometryVariances& variances, double largest, bool keep_unmeasured,
    const OptimizerOptions& options);

}  // namespace loopwise::detail
