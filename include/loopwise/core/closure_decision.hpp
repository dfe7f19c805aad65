// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Decisions of a user on loop closures.
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// A person's decision on the closures between two nodes, in either direction.
struct ClosureDecision {
  Key from = 0;           ///< One of the nodes.
  Key to = 0;             ///< The other.
  bool accepted = false;  ///< True: the closures are known inliers (Edge::trusted). False: they are removed.
};

/// The effect of decisions on a graph.
struct AppliedDecisions {
  std::size_t trusted = 0;                     ///< Closures that are known inliers now.
  std::size_t removed = 0;                     ///< Closures that were removed.
  std::vector<ClosureDecision> without_match;  ///< Decisions on pairs without a closure in the graph.
};

/// Removes rejected closures from the graph and trusts the accepted ones. The other edges keep their order.
/// If a pair has several decisions, the last one counts. Odometry and landmarks are never changed.
LOOPWISE_EXPORT AppliedDecisions apply_decisions(PoseGraph& graph,
                                                 const std::vector<ClosureDecision>& decisions);

}  // namespace loopwise
