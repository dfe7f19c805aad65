// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/pose_graph.hpp>

namespace loopwise::parts {

/// The graph with the keys that `key_of(key)` gives.
template <class KeyOf>
[[nodiscard]] PoseGraph renamed(const PoseGraph& graph, KeyOf&& key_of) {
  PoseGraph out;
  out.set_planar(graph.planar());
  for (Node node : graph.nodes()) {
    node.key = key_of(node.key);
    out.add_node(node);
  }
  for (PriorFactor prior : graph.priors()) {
    prior.key = key_of(prior.key);
    out.add_prior(prior);
  }
  for (Edge edge : graph.edges()) {
    edge.from = key_of(edge.from);
    edge.to = key_of(edge.to);
    out.add_edge(edge);
  }
  for (RangeFactor range : graph.ranges()) {
    range.from = key_of(range.from);
    range.to = key_of(range.to);
    out.add_range(range);
  }
  for (GravityFactor gravity : graph.gravities()) {
    gravity.key = key_of(gravity.key);
    out.add_gravity(gravity);
  }
  return out;
}

}  // namespace loopwise::parts
