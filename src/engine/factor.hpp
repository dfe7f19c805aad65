// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <variant>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/engine/events.hpp>

namespace loopwise {

/// Any factor of a pose graph.
using Factor = std::variant<Edge, PriorFactor, RangeFactor, GravityFactor>;

[[nodiscard]] inline std::vector<Factor> factors_of(const std::vector<Edge>& edges,
                                                    const std::vector<PriorFactor>& priors,
                                                    const std::vector<RangeFactor>& ranges,
                                                    const std::vector<GravityFactor>& gravities) {
  // Priors before edges, so that a path is placed before it is tied; gravity before ranges.
  std::vector<Factor> factors(priors.begin(), priors.end());
  factors.insert(factors.end(), edges.begin(), edges.end());
  factors.insert(factors.end(), gravities.begin(), gravities.end());
  factors.insert(factors.end(), ranges.begin(), ranges.end());
  return factors;
}

[[nodiscard]] inline std::vector<Factor> factors_of(const KeyFrame& frame) {
  return factors_of(frame.factors, frame.priors, frame.ranges, frame.gravities);
}

[[nodiscard]] inline std::vector<Key> keys_of(const Factor& factor) {
  struct Keys {
    std::vector<Key> operator()(const PriorFactor& prior) const { return {prior.key}; }
    std::vector<Key> operator()(const GravityFactor& gravity) const { return {gravity.key}; }
    std::vector<Key> operator()(const Edge& edge) const { return {edge.from, edge.to}; }
    std::vector<Key> operator()(const RangeFactor& range) const { return {range.from, range.to}; }
  };
  return std::visit(Keys{}, factor);
}

inline void add_factor(PoseGraph& graph, const Factor& factor) {
  struct Add {
    PoseGraph& graph;
    void operator()(const Edge& edge) const { graph.add_edge(edge); }
    void operator()(const PriorFactor& prior) const { graph.add_prior(prior); }
    void operator()(const RangeFactor& range) const { graph.add_range(range); }
    void operator()(const GravityFactor& gravity) const { graph.add_gravity(gravity); }
  };
  std::visit(Add{graph}, factor);
}

/// \throws what a graph that has the factor's nodes would
inline void check_factor(const Factor& factor) {
  PoseGraph scratch;
  for (const Key key : keys_of(factor)) {
    Node node;
    node.key = key;
    if (!scratch.contains(key)) scratch.add_node(node);
  }
  add_factor(scratch, factor);
}

}  // namespace loopwise
