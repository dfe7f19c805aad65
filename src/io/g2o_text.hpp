// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// A g2o file with these priors in the place of the graph's own, which may have gone to another file.
[[nodiscard]] std::string g2o_text(const PoseGraph& graph, const std::vector<PriorFactor>& priors);

}  // namespace loopwise
