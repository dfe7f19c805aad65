// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <functional>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Scans of a registration.
struct TaskOptions {
  /// Number of scans before and after the newer node, along its odometry, that are merged with its scan.
  int source_neighbours = 0;
  /// Number of scans before and after the older node that are merged with its scan. The newer node is aligned
  /// to this submap.
  int target_neighbours = 2;
  /// Neighbours are merged, nearest first, only while a submap has fewer points. 0: always.
  std::int64_t enough_points = 2000;
  /// Pass the relative pose of the graph to the registration as its guess.
  bool use_guess = true;
  /// Wall time after which a registration gives up with the reason time_limit, s. 0: no limit. With a limit,
  /// results depend on the machine.
  double time_limit_s = 0.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("source_neighbours", self.source_neighbours, between(0.0, 100.0));
    field("target_neighbours", self.target_neighbours, between(0.0, 100.0));
    field("enough_points", self.enough_points, at_least(0.0));
    field("use_guess", self.use_guess, any_value());
    field("time_limit_s", self.time_limit_s, at_least(0.0));
  }
};

/// The task of a candidate in the current graph. Neighbours and their poses come from the chain of odometry
/// edges of the node's robot and not from the estimate, so a later optimisation never changes a submap. The
/// candidate's other end is never a neighbour, because its pose there would come from odometry instead of a
/// measurement. Their covariances are those of the odometry, with at most 0.5 m and 0.1 rad for a step. A
/// neighbour beyond the end of the chain, or without a scan by `has_scan` (empty: all have
/// scans), is left out; the chain continues past a missing scan. The seed is pair_seed(seed, from, to).
/// \throws UnknownKeyError if the graph lacks a node of the candidate.
[[nodiscard]] LOOPWISE_EXPORT RegistrationTask make_task(const PoseGraph& graph, const Robots& robots,
                                                         const LoopCandidate& candidate,
                                                         const TaskOptions& options, std::uint64_t seed,
                                                         const std::function<bool(Key)>& has_scan = {});

/// Hash of the pair, guess, its covariance, submaps and seed of a task. It does not include options, contents
/// of scans and the time limit.
[[nodiscard]] LOOPWISE_EXPORT ContentHash hash_of(const RegistrationTask& task);

}  // namespace loopwise
