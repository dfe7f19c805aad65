// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/priors.hpp>

#include <loopwise/core/error.hpp>

#include "testing.hpp"

namespace loopwise::priors_test {
namespace {

/// Two nodes with an edge, and one apart from them.
PoseGraph two_components() {
  PoseGraph graph;
  Rng rng(3);
  for (const Key key : {make_key('a', 0), make_key('a', 1), make_key('b', 7)}) {
    Node node;
    node.key = key;
    node.pose = testing::random_pose(rng);
    graph.add_node(node);
  }
  Edge edge;
  edge.from = make_key('a', 0);
  edge.to = make_key('a', 1);
  graph.add_edge(edge);
  return graph;
}

}  // namespace

TEST_CASE("priors: a prior is at the pose of its node, with the given deviations", "[core][prior]") {
  const PoseGraph graph = two_components();
  const PriorFactor prior = prior_at(graph, make_key('b', 7), 0.1, 0.02);
  REQUIRE(prior.key == make_key('b', 7));
  REQUIRE(prior.pose.matrix() == graph.nodes()[2].pose.matrix());
  Vector6d sigmas;
  sigmas << 0.1, 0.1, 0.1, 0.02, 0.02, 0.02;
  const Matrix6d covariance = sigmas.cwiseAbs2().asDiagonal();
  REQUIRE((prior.information * covariance).isIdentity(1e-12));
  REQUIRE_THROWS_AS(prior_at(graph, make_key('c', 0)), UnknownKeyError);
}

TEST_CASE("priors: the text gives key and deviations", "[core][prior]") {
  const PoseGraph graph = two_components();
  const auto parsed = [&](const std::string& text) { return parse_prior("--prior", text, graph); };
  REQUIRE(parsed("b7").key == make_key('b', 7));
  REQUIRE(parsed(std::to_string(make_key('b', 7))).key == make_key('b', 7));
  REQUIRE(parsed("a1").information == prior_at(graph, make_key('a', 1)).information);
  REQUIRE(parsed("a1:0.5").information == prior_at(graph, make_key('a', 1), 0.5).information);
  REQUIRE(parsed("a1:0.5:0.25").information == prior_at(graph, make_key('a', 1), 0.5, 0.25).information);

  REQUIRE_THROWS_WITH(parsed("a1:1:2:3"), "--prior a1:1:2:3: expected KEY[:sigma_m[:sigma_rad]]");
  REQUIRE_THROWS_WITH(parsed("c0"), "--prior c0: the graph has no such node");
  REQUIRE_THROWS_WITH(parsed("abc"), Contains("--prior abc: ") && Contains("is not a key"));
  for (const char* text : {"a1:0", "a1:-1", "a1:inf", "a1:nan", "a1:", "a1:1x", "a1:1:x"}) {
    CAPTURE(text);
    REQUIRE_THROWS_AS(parsed(text), OptionError);
    REQUIRE_THROWS_WITH(parsed(text), Contains("is not a positive number"));
  }
}

TEST_CASE("priors: each component is anchored at its first node", "[core][prior]") {
  PoseGraph graph = two_components();
  REQUIRE(anchor_components(graph, 0.5, 0.25) == 2);
  REQUIRE(graph.priors().size() == 2);
  REQUIRE(graph.priors()[0].key == make_key('a', 0));
  REQUIRE(graph.priors()[1].key == make_key('b', 7));
  REQUIRE(graph.priors()[1].information == prior_at(graph, make_key('b', 7), 0.5, 0.25).information);
  PoseGraph empty;
  REQUIRE(anchor_components(empty) == 0);
}

}  // namespace loopwise::priors_test
