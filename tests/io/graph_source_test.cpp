// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/graph_source.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>

#include "testing.hpp"

namespace loopwise::graph_source_test {
namespace {

using testing::TemporaryFolder;
using testing::write_text;

/// Four nodes in a row with odometry, and an edge between the second and the last.
PoseGraph row_graph() {
  PoseGraph graph;
  for (std::uint64_t i = 0; i < 4; ++i) {
    Node node;
    node.key = make_key('a', i);
    node.pose.translation().x() = static_cast<double>(i);
    graph.add_node(node);
    if (i == 0) continue;
    Edge edge;
    edge.from = make_key('a', i - 1);
    edge.to = node.key;
    edge.T_from_to.translation().x() = 1.0;
    graph.add_edge(edge);
  }
  Edge closure;
  closure.from = make_key('a', 1);
  closure.to = make_key('a', 3);
  closure.T_from_to.translation().x() = 2.0;
  graph.add_edge(closure);
  return graph;
}

std::size_t count(const PoseGraph& graph, EdgeKind kind) {
  std::size_t number = 0;
  for (const Edge& edge : graph.edges()) number += edge.kind == kind ? 1 : 0;
  return number;
}

}  // namespace

TEST_CASE("graph source: paths of recordings and runs", "[io][graph]") {
  const TemporaryFolder folder;
  for (const char* name : {"a.bag", "a.db3", "a.mcap", "a.db3.zstd", "a.zip", "mission.json"})
    REQUIRE(is_recording(folder / name));
  for (const char* name : {"a.g2o", "a.tum", "poses.txt"}) REQUIRE_FALSE(is_recording(folder / name));
  REQUIRE(is_recording(folder.path()));

  REQUIRE(graph_of_run(folder.path()).empty());
  write_g2o(folder / "graph.g2o", row_graph());
  REQUIRE(graph_of_run(folder.path()).empty());  // the run has not ended
  write_text(folder / "summary.json", "{}");
  REQUIRE(graph_of_run(folder.path()) == folder / "graph.g2o");
}

TEST_CASE("graph source: a file and a run have their closures and no further prior", "[io][graph]") {
  const TemporaryFolder folder;
  write_g2o(folder / "graph.g2o", row_graph());
  const SourceGraph of_file = read_graph(folder / "graph.g2o");
  REQUIRE(of_file.graph.priors().empty());
  REQUIRE(count(of_file.graph, EdgeKind::kOdometry) == 3);
  REQUIRE(count(of_file.graph, EdgeKind::kLoopClosure) == 1);
  REQUIRE(of_file.problems.empty());
  // A mission gets a prior, because a replay needs a common frame.
  REQUIRE(read_mission(folder / "graph.g2o").graph.priors().size() == 1);

  write_text(folder / "summary.json", "{}");
  REQUIRE(count(read_graph(folder.path()).graph, EdgeKind::kOdometry) == 3);
  // The list beside the graph of a run applies, unless another one is given.
  write_text(folder / "odometry.csv", "a0 a1\na1 a2\na2 a3\na1 a3\n");
  REQUIRE(count(read_graph(folder.path()).graph, EdgeKind::kOdometry) == 4);
  MissionOptions options;
  options.odometry = (folder / "mine.csv").string();
  write_text(options.odometry, "a0 a1\na1 a2\n");
  REQUIRE(count(read_graph(folder.path(), options).graph, EdgeKind::kOdometry) == 2);
  REQUIRE(count(read_graph(folder / "graph.g2o").graph, EdgeKind::kOdometry) == 3);
}

TEST_CASE("graph source: a mission has the graph of its reader", "[io][graph]") {
  const TemporaryFolder folder;
  Mission mission;
  mission.graph = row_graph();
  mission.robots = parse_robots("a");
  static_cast<void>(classify_edges(mission.graph, mission.robots));
  write_mission(folder / "mission", mission);
  const SourceGraph source = read_graph(folder / "mission");
  const Mission read = read_mission(folder / "mission");
  REQUIRE(source.graph.edges().size() == read.graph.edges().size());
  REQUIRE(source.graph.priors().size() == read.graph.priors().size());
  REQUIRE(source.problems.all().size() == read.problems.all().size());
}

TEST_CASE("graph source: strict refuses a file that would be repaired", "[io][graph]") {
  const TemporaryFolder folder;
  write_text(folder / "bare.g2o",
             "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n"
             "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1\n");
  REQUIRE(read_graph(folder / "bare.g2o").problems.count("edge without information") == 1);
  MissionOptions options;
  options.strict = true;
  REQUIRE_THROWS_AS(read_graph(folder / "bare.g2o", options), InputError);
  REQUIRE_THROWS_AS(read_graph(folder / "absent.g2o"), IoError);
}

TEST_CASE("graph source: every node belongs to a listed robot", "[io][graph][error]") {
  const TemporaryFolder folder;
  write_g2o(folder / "g.g2o", row_graph());
  MissionOptions options;
  options.robots = "a";
  REQUIRE(count(read_graph(folder / "g.g2o", options).graph, EdgeKind::kOdometry) == 3);
  options.robots = std::to_string(make_key('a', 0)) + "-" + std::to_string(make_key('a', 2));
  REQUIRE_THROWS_WITH(read_graph(folder / "g.g2o", options),
                      Catch::Matchers::Contains("belongs to no robot"));
}

}  // namespace loopwise::graph_source_test
