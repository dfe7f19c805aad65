// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <optional>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// Covariances of the relative poses T_from_to of candidates by odometry and priors alone, over the right
/// perturbation, order translation, rotation, m² and rad². Other closures make an estimate more certain than
/// this. One per candidate; nothing where a node is not in the graph, or where neither odometry nor priors
/// join both. First order in the noise; O(nodes · log nodes + candidates).
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::optional<Matrix6d>> odometry_covariances(
    const PoseGraph& graph, const std::vector<LoopCandidate>& candidates);

}  // namespace loopwise
