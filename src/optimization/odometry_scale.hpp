// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise::detail {

/// The chain of every node, named by its first node. Edges of kind odometry join the nodes of a chain. The
/// name does not change while a graph grows, unless new odometry joins two chains.
[[nodiscard]] std::vector<std::uint32_t> odometry_chains(const PoseGraph& graph);

/// Variance factors of odometry by the first node of its chain: the ratio of true to stated covariance. A
/// missing chain has 1.
using OdometryVariances = std::map<std::uint32_t, double>;

/// An estimate of variance factors at a solution that was found with earlier ones.
struct OdometryEstimate {
  OdometryVariances variances;
  /// Σ redundancy · ln(earlier factor) over the chains: what restricted maximum likelihood charges for the
  /// earlier factors. Half of it, added to the cost, compares solutions with different factors.
  double log_determinant = 0.0;
  /// Whether the residuals of a chain are noticeably too large even for the largest factor. Meaningful at a
  /// minimum that was found with about that factor.
  bool beyond_largest = false;
};

/// The graph with the information of its odometry divided by the variance factors.
[[nodiscard]] PoseGraph with_odometry_variances(const PoseGraph& graph,
                                                const std::vector<std::uint32_t>& chains,
                                                const OdometryVariances& variances);

/// Estimates variance factors from the redundancy of the chains (variance component estimation, Förstner
/// 1979): s² = Σ rᵀΩr / Σ (d − tr(Ω J Σ Jᵀ)) over a chain's edges, each with d degrees of freedom. Edges of
/// singular information are not used. The factor is 1 for chains that agree with their stated information and
/// for chains that nothing else measures. It is at least 1 and at most `largest`.
/// \param graph as stated \param poses, weights the minimum, found with these `variances`
/// \param keep_unmeasured whether chains that nothing else measures keep their factor in `variances`
/// \returns nothing if the factors leave a pose undetermined, so that covariances do not exist
[[nodiscard]] std::optional<OdometryEstimate> estimated_odometry_variances(
    const PoseGraph& graph, const std::vector<std::uint32_t>& chains,
    const std::vector<Eigen::Isometry3d>& poses, const std::vector<double>& weights,
    const OdometryVariances& variances, double largest, bool keep_unmeasured,
    const OptimizerOptions& options);

}  // namespace loopwise::detail
