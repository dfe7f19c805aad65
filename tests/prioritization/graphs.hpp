// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Graphs with candidates for the tests of graph information, and the slow obvious way to score a set.
#pragma once

#include <algorithm>
#include <vector>

#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>

#include "optimization/support.hpp"
#include "testing.hpp"

namespace loopwise::testing {

inline LoopCandidate candidate_of(CandidateId id, Key from, Key to) {
  LoopCandidate candidate;
  candidate.id = id;
  candidate.from = from;
  candidate.to = to;
  return candidate;
}

/// `count` random distinct pairs of nodes that are not neighbours.
inline std::vector<LoopCandidate> random_candidates(const PoseGraph& graph, std::size_t count, Rng& rng) {
  std::set<std::pair<Key, Key>> pairs;
  const std::size_t n = graph.nodes().size();
  while (pairs.size() < count) {
    const std::size_t a = rng.below(n), b = rng.below(n);
    if (a > b + 1) pairs.emplace(graph.nodes()[a].key, graph.nodes()[b].key);
  }
  std::vector<LoopCandidate> out;
  for (const auto& [from, to] : pairs) out.push_back(candidate_of(out.size(), from, to));
  rng.shuffle(out);
  return out;
}

/// The graph with the candidates of a set as closures that measure the estimate.
inline PoseGraph with_closures(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                               const std::vector<std::size_t>& set, const Matrix6d& covariance) {
  PoseGraph out = graph;
  for (const std::size_t i : set) {
    Edge edge;
    edge.from = candidates[i].from;
    edge.to = candidates[i].to;
    edge.T_from_to = graph.node(edge.from).pose.inverse() * graph.node(edge.to).pose;
    const Matrix6d information = covariance.inverse();
    edge.information = 0.5 * (information + information.transpose());
    out.add_edge(edge);
  }
  return out;
}

/// e(PG ∪ set): add the closures, factorise, invert.
inline double brute_force(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                          const std::vector<std::size_t>& set, const ClosureModelOptions& options = {}) {
  const Marginals m = marginals(with_closures(graph, candidates, set, closure_model(options).covariance));
  return options.trace == TraceKind::kFull ? m.trace_full : m.trace_translation;
}

/// Odometry of a graph alone, with its priors.
inline PoseGraph odometry_only(const PoseGraph& graph) {
  PoseGraph out = graph;
  out.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry; });
  return out;
}

}  // namespace loopwise::testing
