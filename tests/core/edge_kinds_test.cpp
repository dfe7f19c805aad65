// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/error.hpp>
#include <loopwise/core/pose_graph.hpp>

#include "testing.hpp"

namespace loopwise::edge_kinds_test {
namespace {

constexpr double kStep = 1.0;

PoseGraph nodes(const std::vector<Key>& keys) {
  PoseGraph graph;
  for (const Key key : keys) {
    Node node;
    node.key = key;
    node.pose.translation().x() = kStep * static_cast<double>(graph.nodes().size());
    graph.add_node(node);
  }
  return graph;
}

/// An edge with the relative pose of the nodes, plus an error of so many metres.
Edge measured(const PoseGraph& graph, Key from, Key to, double off_m = 0.0) {
  Edge edge;
  edge.from = from;
  edge.to = to;
  edge.T_from_to = graph.node(from).pose.inverse() * graph.node(to).pose;
  edge.T_from_to.translation().y() += off_m;
  edge.information.diagonal() << Eigen::Vector3d::Constant(1e4), Eigen::Vector3d::Constant(1e6);
  return edge;
}

std::vector<EdgeKind> kinds(const PoseGraph& graph) {
  std::vector<EdgeKind> kinds;
  for (const Edge& edge : graph.edges()) kinds.push_back(edge.kind);
  return kinds;
}

Problems classify(PoseGraph& graph) {
  return classify_edges(graph, Robots::from_keys(graph.keys()));
}

constexpr EdgeKind kOdometry = EdgeKind::kOdometry, kClosure = EdgeKind::kLoopClosure;
const char* const kBroken = "odometry chain broken";
const char* const kContradicts = "edge that contradicts the odometry, treated as a loop closure";

}  // namespace

TEST_CASE("edges: odometry joins neighbours in either direction, over gaps of ids",
          "[core][graph][odometry]") {
  const std::vector<Key> keys = GENERATE(values<std::vector<Key>>(
      {{0, 1, 2, 3},
       {0, 10, 20, 30},
       {76, 78, 80, 85},
       {make_key('c', 5), make_key('c', 9), make_key('c', 10), make_key('c', 1000)}}));
  const bool backwards = GENERATE(false, true);
  PoseGraph graph = nodes(keys);
  for (std::size_t i = 1; i < keys.size(); ++i) {
    graph.add_edge(backwards ? measured(graph, keys[i], keys[i - 1]) : measured(graph, keys[i - 1], keys[i]));
  }
  graph.add_edge(measured(graph, keys[0], keys[2]));
  REQUIRE(classify(graph).empty());
  REQUIRE(kinds(graph) == std::vector<EdgeKind>{kOdometry, kOdometry, kOdometry, kClosure});
}

TEST_CASE("edges: nodes may come in any order, and other robots between them", "[core][graph][odometry]") {
  PoseGraph graph = nodes({40, make_key('b', 7), 10, make_key('b', 3), 20});
  graph.add_edge(measured(graph, 20, 10));
  graph.add_edge(measured(graph, 20, 40));
  graph.add_edge(measured(graph, make_key('b', 7), make_key('b', 3)));
  graph.add_edge(measured(graph, 40, make_key('b', 3)));  // the next key, but of another robot
  REQUIRE(classify(graph).empty());
  REQUIRE(kinds(graph) == std::vector<EdgeKind>{kOdometry, kOdometry, kOdometry, kClosure});
}

TEST_CASE("edges: every robot's broken chain is a problem that names the place", "[core][graph][odometry]") {
  PoseGraph graph = nodes({0, 10, 20, 30, make_key('b', 1), make_key('b', 2)});
  graph.add_edge(measured(graph, 0, 10));
  graph.add_edge(measured(graph, 30, 20));
  graph.add_edge(measured(graph, 10, 30));  // a closure: joins no neighbours
  Problems problems = classify(graph);
  REQUIRE(problems.count(kBroken) == 2);
  REQUIRE(problems.all().front().example == "robot 0, between nodes 10 and 20");
  graph.add_edge(measured(graph, 10, 20));
  problems = classify(graph);
  REQUIRE(problems.count(kBroken) == 1);
  REQUIRE(problems.all().front().example == "robot b, between nodes b1 and b2");

  // Landmarks have no odometry, and so no chain.
  std::vector<Robot> robots = Robots::from_keys(graph.keys()).all();
  robots.back().landmarks = true;
  REQUIRE(classify_edges(graph, Robots(robots)).empty());
}

TEST_CASE("edges: of two between neighbours that contradict each other, one is a closure",
          "[core][graph][odometry]") {
  PoseGraph graph = nodes({0, 2, 4});
  graph.add_edge(measured(graph, 0, 2));
  const bool false_first = GENERATE(false, true), backwards = GENERATE(false, true);
  const Edge right = measured(graph, 2, 4);
  Edge wrong = measured(graph, 2, 4, 0.5);
  if (backwards) wrong = reversed(wrong);
  graph.add_edge(false_first ? wrong : right);
  graph.add_edge(false_first ? right : wrong);
  graph.add_edge(reversed(measured(graph, 2, 4, 0.01)));  // says the same, within its sigma
  const Problems problems = classify(graph);
  REQUIRE(problems.count(kContradicts) == 1);
  REQUIRE_THAT(problems.all().front().example,
               Contains("between " + std::string(backwards ? "4 and 2" : "2 and 4")) && Contains("0.5"));
  REQUIRE(problems.count(kBroken) == 0);
  REQUIRE(graph.edges()[1].kind == (false_first ? kClosure : kOdometry));
  REQUIRE(graph.edges()[2].kind == (false_first ? kOdometry : kClosure));
  REQUIRE(graph.edges()[3].kind == kOdometry);

  // If the poses agree with neither edge, as in a file that was never chained, the first edge is odometry.
  graph.set_poses(std::vector<Eigen::Isometry3d>(3, Eigen::Isometry3d::Identity()));
  REQUIRE(classify(graph).count(kContradicts) == (false_first ? 2 : 1));
  REQUIRE(graph.edges()[1].kind == kOdometry);
}

TEST_CASE("edges: a weak edge that agrees with all hides no contradiction", "[core][graph][odometry]") {
  PoseGraph graph = nodes({0, 1});
  Edge weak = measured(graph, 0, 1, 0.2);
  weak.information = 0.01 * Matrix6d::Identity();
  std::vector<Edge> edges = {weak, measured(graph, 0, 1), measured(graph, 0, 1, 5.0)};
  const std::vector<std::size_t> order =
      GENERATE(values<std::vector<std::size_t>>({{0, 1, 2}, {0, 2, 1}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}}));
  for (const std::size_t i : order) graph.add_edge(edges[i]);
  const bool chained = GENERATE(true, false);
  if (!chained) graph.set_poses(std::vector<Eigen::Isometry3d>(2, Eigen::Isometry3d::Identity()));
  const Problems problems = classify(graph);
  REQUIRE(problems.count(kContradicts) == 1);
  REQUIRE(problems.count(kBroken) == 0);
  const bool right_first = order[0] == 1 || (order[0] == 0 && order[1] == 1);
  for (std::size_t i = 0; i < 3; ++i) {
    const bool is_closure = order[i] == (chained || right_first ? 2 : 1);
    REQUIRE(graph.edges()[i].kind == (is_closure ? kClosure : kOdometry));
  }
}

TEST_CASE("edges: a list of pairs determines the odometry", "[core][graph][odometry]") {
  PoseGraph graph = nodes({0, 1, 2});
  graph.add_edge(measured(graph, 0, 2));
  graph.add_edge(measured(graph, 1, 0));
  graph.add_edge(measured(graph, 1, 2));
  const Robots robots = Robots::from_keys(graph.keys());
  // From 1 to 2 by way of 0: no break.
  REQUIRE(classify_edges(graph, robots, {{2, 0}, {0, 1}}).empty());
  REQUIRE(kinds(graph) == std::vector<EdgeKind>{kOdometry, kOdometry, kClosure});
  REQUIRE(classify_edges(graph, robots, {{1, 2}}).count(kBroken) == 1);
  REQUIRE_THROWS_WITH(classify_edges(graph, robots, {{1, 7}}), "the graph has no edge between 1 and 7");
  std::vector<Robot> with_landmark = {{"r", 0, 1}, {"seen", 2, 9}};
  with_landmark.back().landmarks = true;
  REQUIRE_THROWS_WITH(classify_edges(graph, Robots(with_landmark), {{0, 1}, {2, 1}}),
                      "no odometry between 1 and 2: 2 is a landmark");
}

TEST_CASE("edges: the same measurement from its other end costs the same", "[core][graph][odometry]") {
  Rng rng(3);
  Edge edge;
  edge.from = 1;
  edge.to = 2;
  edge.T_from_to = testing::random_pose(rng);
  const Matrix6d root = Matrix6d::NullaryExpr([&] { return rng.normal(); });
  edge.information = root * root.transpose();
  const Eigen::Isometry3d a = testing::random_pose(rng);
  Vector6d xi;
  for (int k = 0; k < 6; ++k) xi[k] = rng.normal(0.0, 1e-5);
  const Eigen::Isometry3d b = a * edge.T_from_to * se3::exp(xi);
  const auto cost = [](const Edge& e, const Eigen::Isometry3d& from, const Eigen::Isometry3d& to) {
    const Vector6d r = se3::log(e.T_from_to.inverse() * from.inverse() * to);
    return r.dot(e.information * r);
  };
  const Edge other = reversed(edge);
  REQUIRE(other.from == 2);
  REQUIRE(cost(other, b, a) == Approx(cost(edge, a, b)).epsilon(1e-4));  // measured: 2e-5
}

TEST_CASE("robots: labels in the keys distinguish robots, ordinary symbols have no label", "[core][robots]") {
  const auto labelled = [](char character, char label, Key index) {
    return make_key(character, (Key{static_cast<unsigned char>(label)} << 48) | index);
  };
  REQUIRE(key_name(labelled('g', 'B', 12)) == "gB12");
  REQUIRE(parse_key("gB12") == labelled('g', 'B', 12));
  REQUIRE(key_name(make_key('g', 12)) == "g12");
  REQUIRE(key_label(make_key('g', (Key{1} << 48) - 1)) == '\0');
  REQUIRE(key_label(1700000000123456789) == '\0');              // a stamp in ns
  REQUIRE(key_label(make_key('x', 1700000000123456)) == '\0');  // of a symbol by stamp in us
  REQUIRE_THROWS_WITH(parse_key("gB281474976710656"), Contains("is not a key"));
  REQUIRE_THROWS_WITH(parse_key("gBC1"), Contains("is not a key"));

  PoseGraph graph = nodes({labelled('g', 'A', 0), labelled('g', 'A', 1), labelled('g', 'B', 0),
                           labelled('g', 'B', 3), make_key('g', 5), make_key('h', 5)});
  graph.add_edge(measured(graph, labelled('g', 'A', 0), labelled('g', 'A', 1)));
  graph.add_edge(measured(graph, labelled('g', 'A', 1), labelled('g', 'B', 0)));
  graph.add_edge(measured(graph, labelled('g', 'B', 3), labelled('g', 'B', 0)));
  const Robots robots = Robots::from_keys(graph.keys());
  std::vector<std::string> names;
  for (const Robot& robot : robots.all()) names.push_back(robot.name);
  REQUIRE(names == std::vector<std::string>{"g", "gA", "gB", "h"});
  REQUIRE(robots.node_index(labelled('g', 'B', 3)) == 3);
  REQUIRE(classify_edges(graph, robots).empty());
  REQUIRE(kinds(graph) == std::vector<EdgeKind>{kOdometry, kClosure, kOdometry});
  REQUIRE(parse_robots("gA,left=gB").of(labelled('g', 'B', 3)) == 1);

  // Labels that are not letters are not recognised: the two halves of the "robot" are not joined.
  PoseGraph numbered = nodes({make_key('x', 0), make_key('x', 1), make_key('x', (Key{1} << 48) + 0),
                              make_key('x', (Key{1} << 48) + 1)});
  for (std::size_t i = 1; i < 4; ++i)
    numbered.add_edge(measured(numbered, numbered.keys()[i - 1], numbered.keys()[i]));
  const Problems problems = classify(numbered);
  REQUIRE(problems.all().size() == 1);
  REQUIRE(problems.count("robot whose keys have a jump of 2^47 or more") == 1);
  REQUIRE_THAT(problems.all().front().example, Contains("robot x, between nodes x1 and x281474976710656"));
  REQUIRE(kinds(numbered) == std::vector<EdgeKind>{kOdometry, kClosure, kOdometry});
}

TEST_CASE("edges: odometry of a planar graph is judged by three degrees of freedom",
          "[core][graph][odometry][planar]") {
  const bool is_planar = GENERATE(true, false);
  CAPTURE(is_planar);
  PoseGraph graph = nodes({0, 1});
  graph.set_planar(is_planar);
  graph.add_edge(measured(graph, 0, 1));
  graph.add_edge(measured(graph, 0, 1, 0.07));  // d² of both: 24.5, thresholds 21.1 and 27.9
  REQUIRE(classify(graph).count(kContradicts) == (is_planar ? 1 : 0));
  REQUIRE(kinds(graph) == std::vector<EdgeKind>{kOdometry, is_planar ? kClosure : kOdometry});
}

}  // namespace loopwise::edge_kinds_test
