// SPDX-License-Identifier: BSD-3-Clause
#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/core/pose_graph.hpp>

#include "testing.hpp"

namespace loopwise::pose_graph_test {
namespace {

PoseGraph chain(Key count) {
  PoseGraph graph;
  for (Key k = 0; k < count; ++k) {
    Node node;
    node.key = k;
    node.pose.translation().x() = static_cast<double>(k);
    graph.add_node(node);
    if (k > 0) {
      Edge edge;
      edge.from = k - 1;
      edge.to = k;
      edge.T_from_to.translation().x() = 1.0;
      graph.add_edge(edge);
    }
  }
  return graph;
}

Edge edge_between(Key from, Key to) {
  Edge edge;
  edge.from = from;
  edge.to = to;
  return edge;
}

}  // namespace

TEST_CASE("graph: adjacency and ends follow the edges", "[core][graph]") {
  PoseGraph graph = chain(5);
  const std::size_t closure = graph.add_edge(edge_between(4, 0));
  REQUIRE(graph.edges_of(graph.index_of(0)) == std::vector<std::size_t>{0, closure});
  REQUIRE(graph.ends(closure).from == 4);
  REQUIRE(graph.ends(closure).to == 0);

  REQUIRE(graph.remove_edges_if([](const Edge& e) { return e.from == 1; }) == 1);
  REQUIRE(graph.edges().size() == 4);
  REQUIRE(graph.edges_of(graph.index_of(0)) == std::vector<std::size_t>{0, 3});
  REQUIRE(graph.edges_of(graph.index_of(1)) == std::vector<std::size_t>{0});
}

TEST_CASE("graph: bad input is refused with its key, and nothing changes", "[core][graph][error]") {
  PoseGraph graph = chain(3);
  const double nan = std::numeric_limits<double>::quiet_NaN();

  Node repeated;
  repeated.key = 1;
  REQUIRE_THROWS_WITH(graph.add_node(repeated), "node 1 is in the graph already");
  Node broken;
  broken.key = make_key('a', 7);
  broken.pose.translation().y() = nan;
  REQUIRE_THROWS_WITH(graph.add_node(broken), Contains("a7") && Contains("pose is not finite"));
  Node sheared;
  sheared.key = 9;
  sheared.pose.linear()(0, 0) = 2.0;
  REQUIRE_THROWS_WITH(graph.add_node(sheared), Contains("not a rigid transform"));

  REQUIRE_THROWS_AS(graph.add_edge(edge_between(0, 77)), UnknownKeyError);
  REQUIRE_THROWS_WITH(graph.add_edge(edge_between(2, 2)), "edge 2 to 2: both ends are the same node");
  REQUIRE_THROWS_WITH(graph.set_information(0, -Matrix6d::Identity()), Contains("information is indefinite"));
  Edge edge = edge_between(0, 2);
  edge.information(0, 0) = -1.0;
  REQUIRE_THROWS_WITH(graph.add_edge(edge), "edge 0 to 2: information is indefinite");
  edge.information = Matrix6d::Identity();
  edge.information(0, 1) = 0.5;
  REQUIRE_THROWS_WITH(graph.add_edge(edge), "edge 0 to 2: information is not symmetric");
  edge.information(0, 1) = nan;
  REQUIRE_THROWS_WITH(graph.add_edge(edge), "edge 0 to 2: information is not finite");
  PriorFactor prior;
  prior.key = 50;
  REQUIRE_THROWS_AS(graph.add_prior(prior), UnknownKeyError);
  LoopClosure closure;
  closure.from = 2;
  closure.to = 0;
  closure.covariance.setZero();
  REQUIRE_THROWS_WITH(graph.add_closure(closure), Contains("not positive definite"));
  REQUIRE_THROWS_AS(graph.set_poses({}), InputError);

  REQUIRE(graph.nodes().size() == 3);
  REQUIRE(graph.edges().size() == 2);
  REQUIRE(graph.priors().empty());
}

TEST_CASE("graph: numbers of nodes and edges that it does not have are errors of the library",
          "[core][graph][error]") {
  PoseGraph graph = chain(3);
  const std::string absent = "edge number 7 is not in the graph, which has 2 edges, numbered from 0";
  REQUIRE_THROWS_WITH(graph.set_weight(7, 0.5), absent);
  REQUIRE_THROWS_AS(graph.set_weight(7, 0.5), InputError);
  REQUIRE_THROWS_WITH(graph.set_trusted(7, true), absent);
  REQUIRE_THROWS_WITH(graph.set_information(7, Matrix6d::Identity()), absent);
  REQUIRE_THROWS_WITH(graph.set_kind(7, EdgeKind::kOdometry), absent);
  REQUIRE_THROWS_WITH(graph.ends(7), absent);
  REQUIRE_THROWS_WITH(graph.edges_of(3),
                      "node number 3 is not in the graph, which has 3 nodes, numbered from 0");
  REQUIRE_THROWS_WITH(graph.set_covariance(3, std::nullopt),
                      "node number 3 is not in the graph, which has 3 nodes, numbered from 0");
  REQUIRE_THROWS_WITH(graph.set_weight(1, 2.0), "edge 1 to 2: weight is outside [0, 1]");
  REQUIRE_NOTHROW(graph.set_weight(1, 0.5));
}

TEST_CASE("graph: information may be singular and badly scaled", "[core][graph]") {
  Matrix6d information = Matrix6d::Zero();
  REQUIRE(check_information(information) == nullptr);
  information.diagonal() << 1e-6, 1e-6, 1e-6, 1e12, 1e12, 0.0;
  REQUIRE(check_information(information) == nullptr);
  information(0, 1) = information(1, 0) = 2e-6;  // indefinite in a block that the scale of the other hides
  REQUIRE(std::string(check_information(information)) == "indefinite");
}

TEST_CASE("graph: a closure's information is the inverse of its covariance", "[core][graph]") {
  PoseGraph graph = chain(3);
  LoopClosure closure;
  closure.from = 2;
  closure.to = 0;
  closure.covariance.diagonal() << 0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4;
  closure.covariance(0, 4) = closure.covariance(4, 0) = 1e-4;
  const std::size_t e = graph.add_closure(closure);
  REQUIRE((graph.edges()[e].information * closure.covariance - Matrix6d::Identity()).cwiseAbs().maxCoeff() <
          1e-12);
}

TEST_CASE("graph: components and the kinds of edges", "[core][graph]") {
  PoseGraph graph;
  for (const Key k : {0, 1, 2, 10, 11, 20}) {
    Node node;
    node.key = k;
    graph.add_node(node);
  }
  graph.add_edge(edge_between(1, 0));
  graph.add_edge(edge_between(1, 2));
  graph.add_edge(edge_between(10, 11));
  REQUIRE(connected_components(graph) == std::vector<std::size_t>{0, 0, 0, 1, 1, 2});

  graph.add_edge(edge_between(2, 10));
  REQUIRE(connected_components(graph) == std::vector<std::size_t>{0, 0, 0, 0, 0, 1});

  classify_edges(graph, Robots({{"x", 0, 9}, {"y", 10, 19}}));
  REQUIRE(graph.edges()[0].kind == EdgeKind::kOdometry);  // backwards
  REQUIRE(graph.edges()[1].kind == EdgeKind::kOdometry);
  REQUIRE(graph.edges()[2].kind == EdgeKind::kOdometry);
  REQUIRE(graph.edges()[3].kind == EdgeKind::kLoopClosure);
}

TEST_CASE("graph: nothing leaves the plane of a planar graph", "[core][graph][planar]") {
  PoseGraph graph = chain(3);
  CHECK_FALSE(graph.planar());
  CHECK(graph.degrees_of_freedom() == 6);
  graph.set_planar();
  REQUIRE(graph.planar());
  CHECK(graph.degrees_of_freedom() == 3);

  Eigen::Isometry3d above = Eigen::Isometry3d::Identity(), tilted = above;
  above.translation().z() = 1e-300;
  tilted.linear() = se3::so3_exp({0.0, 1e-9, 0.3});
  for (const Eigen::Isometry3d& pose : {above, tilted}) {
    Node node;
    node.key = 9;
    node.pose = pose;
    Edge edge = edge_between(0, 2);
    edge.T_from_to = pose;
    const auto leaves = Contains("pose has z, roll or pitch, but the graph is planar");
    REQUIRE_THROWS_WITH(graph.add_node(node), leaves && Contains("node 9"));
    REQUIRE_THROWS_WITH(graph.add_edge(edge), leaves && Contains("edge 0 to 2"));
    REQUIRE_THROWS_WITH(graph.add_prior({1, pose, Matrix6d::Identity()}), leaves && Contains("prior of 1"));
    REQUIRE_THROWS_WITH(graph.set_pose(1, pose), leaves);
    REQUIRE_THROWS_WITH(graph.set_poses({pose, pose, pose}), leaves);
  }
  Edge tied = edge_between(0, 2);
  tied.information(0, 4) = tied.information(4, 0) = 0.1;
  REQUIRE_THROWS_WITH(graph.add_edge(tied), Contains("information couples z, roll or pitch"));
  REQUIRE_THROWS_WITH(graph.set_information(0, tied.information), Contains("couples z, roll or pitch"));
  GravityFactor gravity;
  gravity.key = 1;
  REQUIRE_THROWS_WITH(graph.add_gravity(gravity), Contains("a planar graph cannot use it"));
  graph.add_range({0, 2, 2.0, 0.1});
  REQUIRE(graph.edges().size() == 2);

  graph.set_planar(false);
  graph.add_gravity(gravity);
  REQUIRE_THROWS_WITH(graph.set_planar(), Contains("gravity at 1"));
  PoseGraph spatial = chain(2);
  spatial.set_pose(1, above);
  REQUIRE_THROWS_WITH(spatial.set_planar(), Contains("node 1: pose has z, roll or pitch"));
  CHECK_FALSE(spatial.planar());
}

}  // namespace loopwise::pose_graph_test
