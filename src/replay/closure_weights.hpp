// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <utility>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Copies the weights of the graph's closures to their candidates.
inline void take_weights(const PoseGraph& graph, std::vector<ComputedCandidate>& computed) {
  std::map<std::pair<Key, Key>, double> weights;
  for (const Edge& edge : graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) weights[{edge.from, edge.to}] = edge.weight;
  }
  for (ComputedCandidate& c : computed) {
    const auto found = weights.find({c.result.candidate.from, c.result.candidate.to});
    if (c.result.verified() && found != weights.end()) c.weight = found->second;
  }
}

}  // namespace loopwise
