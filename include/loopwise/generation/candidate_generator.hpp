// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// Proposes loop candidates as the graph grows. Called from one thread at a time.
class LOOPWISE_EXPORT CandidateGenerator {
 public:
  virtual ~CandidateGenerator() = default;

  /// Short and stable, for tables and logs.
  [[nodiscard]] virtual std::string_view name() const = 0;

  /// The graph gained the node `key` at mission time `time_s`: returns pairs with earlier nodes. A pair is
  /// proposed at most once. The ids of the candidates are not set yet. \throws UnknownKeyError
  [[nodiscard]] virtual std::vector<LoopCandidate> on_node(const PoseGraph& graph, Key key,
                                                           double time_s) = 0;

  /// The back end moved the poses of nodes seen before.
  virtual void on_graph(const PoseGraph& /*graph*/) {}
};

}  // namespace loopwise
