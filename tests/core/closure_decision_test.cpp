// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/closure_decision.hpp>

#include "testing.hpp"

namespace loopwise::closure_decision_test {
namespace {

Edge edge(Key from, Key to, EdgeKind kind) {
  Edge out;
  out.from = from;
  out.to = to;
  out.kind = kind;
  return out;
}

/// Nodes 0 to 4 in a row, and closures 0-2, 3-0, 0-2 again and 1-4.
PoseGraph graph_of_five() {
  PoseGraph graph;
  for (Key key = 0; key < 5; ++key) {
    Node node;
    node.key = key;
    graph.add_node(node);
  }
  for (Key key = 1; key < 5; ++key) graph.add_edge(edge(key - 1, key, EdgeKind::kOdometry));
  for (const auto& [from, to] : {std::pair<Key, Key>{0, 2}, {3, 0}, {0, 2}, {1, 4}}) {
    graph.add_edge(edge(from, to, EdgeKind::kLoopClosure));
  }
  return graph;
}

}  // namespace

TEST_CASE("decisions: rejected closures go, accepted ones are trusted, the rest stays in order",
          "[core][decisions]") {
  PoseGraph graph = graph_of_five();
  const AppliedDecisions applied =
      apply_decisions(graph, {{2, 0, true}, {0, 3, false}, {4, 0, true}, {0, 1, false}});
  REQUIRE(applied.trusted == 2);
  REQUIRE(applied.removed == 1);
  REQUIRE(applied.without_match.size() == 2);  // 0-4 has no closure, 0-1 odometry alone
  REQUIRE(graph.edges().size() == 7);
  for (std::size_t e = 0; e < 4; ++e) REQUIRE(graph.edges()[e].kind == EdgeKind::kOdometry);
  REQUIRE((graph.edges()[4].to == 2 && graph.edges()[4].trusted));
  REQUIRE((graph.edges()[5].to == 2 && graph.edges()[5].trusted));
  REQUIRE((graph.edges()[6].to == 4 && !graph.edges()[6].trusted));
}

TEST_CASE("decisions: the last word on a pair counts", "[core][decisions]") {
  PoseGraph graph = graph_of_five();
  const AppliedDecisions applied = apply_decisions(graph, {{0, 2, true}, {2, 0, false}});
  REQUIRE(applied.trusted == 0);
  REQUIRE(applied.removed == 2);
}

}  // namespace loopwise::closure_decision_test
