// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <variant>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/engine/events.hpp>

namespace loopwise {

/// Any factor of a pose graph.
using Factor = std::variant<Edge, PriorFactor, RangeFactor, GravityFactor>;

/// The factors of a KeyFrame or of Factors. Priors come before edges, so that they place a path before it is
/// joined to others; gravity comes before ranges.
template <class Source>
[[nodiscard]] std::vector<Factor> factors_of(const Source& source) {
  std::vector<Factor> factors(source.priors.begin(), source.priors.end());
  const auto add = [&factors](const std::vector<BetweenFactor>& between, EdgeKind kind) {
    for (const BetweenFactor& f : between) {
      factors.push_back(Edge{f.from, f.to, f.T_from_to, f.information, kind, f.trusted, 1.0});
    }
  };
  add(source.odometry, EdgeKind::kOdometry);
  add(source.closures, EdgeKind::kLoopClosure);
  add(source.landmarks, EdgeKind::kLandmark);
  factors.insert(factors.end(), source.gravities.begin(), source.gravities.end());
  factors.insert(factors.end(), source.ranges.begin(), source.ranges.end());
  return factors;
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

/// \throws the exception of a graph that has the factor's nodes
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
