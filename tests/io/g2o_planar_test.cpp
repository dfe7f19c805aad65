// SPDX-License-Identifier: BSD-3-Clause
// Graphs of the plane in g2o files.
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>

#include "g2o_text.hpp"
#include "testing.hpp"

namespace loopwise::g2o_planar_test {
namespace {

using testing::TemporaryFolder;

const std::string kTwoVertices = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0.5 0.25\n";
const std::string kEdge = "EDGE_SE2 0 1 1 0.5 0.25 10 1 2 20 3 30\n";
const std::string kSpatialVertex = "VERTEX_SE3:QUAT 7 0 0 0 0 0 0 1\n";

G2oFile read(const std::string& text) {
  return parse_g2o(text, "run.g2o");
}

std::string written(const PoseGraph& graph) {
  return g2o_text(graph, graph.priors());
}

/// A drive of `count` poses with closures, a prior and information that is not diagonal.
PoseGraph drive(std::size_t count, unsigned seed) {
  Rng rng(seed);
  const auto random = [&] { return planar::pose(10.0 * rng.normal(), rng.normal(), 4.0 * rng.normal()); };
  const auto information = [&] {
    Eigen::Matrix3d A;
    for (int i = 0; i < 9; ++i) A(i / 3, i % 3) = rng.normal();
    const Eigen::Matrix3d m = 50.0 * (A * A.transpose());
    return planar::information(m + m.transpose());
  };
  PoseGraph graph;
  graph.set_planar();
  for (std::size_t i = 0; i < count; ++i) {
    Node node;
    node.key = i;
    node.pose = random();
    graph.add_node(node);
  }
  for (std::size_t i = 1; i < count; ++i) graph.add_edge({i - 1, i, random(), information()});
  for (std::size_t i = 3; i < count; i += 2) graph.add_edge({i, i - 3, random(), information()});
  graph.add_prior({0, random(), information()});
  return graph;
}

}  // namespace

TEST_CASE("g2o: a 2D graph is a planar one", "[io][g2o][planar]") {
  const G2oFile file = read(kTwoVertices + kEdge + "EDGE_PRIOR_SE2 1 1 0.5 3 100 0 0 200 0 300\nFIX 0\n");
  CHECK(file.problems.empty());
  const PoseGraph& graph = file.graph;
  REQUIRE(graph.planar());
  CHECK(graph.degrees_of_freedom() == 3);
  CHECK(graph.nodes()[1].pose.matrix() == planar::pose(1.0, 0.5, 0.25).matrix());
  CHECK(planar::heading(graph.nodes()[1].pose) == Approx(0.25));
  REQUIRE(graph.edges().size() == 1);
  CHECK(graph.edges()[0].kind == EdgeKind::kOdometry);
  Eigen::Matrix3d expected;
  expected << 10, 1, 2, 1, 20, 3, 2, 3, 30;
  CHECK(planar::block(graph.edges()[0].information) == expected);
  CHECK(planar::is_information(graph.edges()[0].information));
  // Of the size of the other information, and regular.
  CHECK(graph.edges()[0].information(2, 2) == 15.0);
  CHECK(graph.edges()[0].information(3, 3) == 30.0);
  CHECK(graph.edges()[0].information(4, 4) == 30.0);
  REQUIRE(graph.priors().size() == 2);
  CHECK(planar::heading(graph.priors()[0].pose) == Approx(3.0));
  CHECK(graph.priors()[1].information(5, 5) == Approx(1e8));
  CHECK_FALSE(read(kSpatialVertex).graph.planar());
}

TEST_CASE("g2o: a written 2D graph is read back unchanged", "[io][g2o][planar]") {
  const unsigned seed = GENERATE(range(1u, 11u));
  CAPTURE(seed);
  const PoseGraph graph = drive(20, seed);
  const std::string text = written(graph);
  CHECK(text.find("SE3") == std::string::npos);
  const G2oFile back = read(text);
  CHECK(back.problems.empty());
  REQUIRE(back.graph.planar());
  REQUIRE(back.graph.keys() == graph.keys());
  REQUIRE(back.graph.edges().size() == graph.edges().size());
  REQUIRE(back.graph.priors().size() == 1);
  for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
    const Eigen::Isometry3d &a = graph.nodes()[i].pose, &b = back.graph.nodes()[i].pose;
    CHECK(a.translation() == b.translation());
    CHECK(testing::difference(a, b) < 1e-15);
  }
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge &a = graph.edges()[e], &b = back.graph.edges()[e];
    CHECK((a.from == b.from && a.to == b.to));
    CHECK(testing::difference(a.T_from_to, b.T_from_to) < 1e-15);
    CHECK(planar::block(a.information) == planar::block(b.information));
  }
  CHECK(written(back.graph) == text);
}

TEST_CASE("g2o: angles of a 2D graph are written as they were read", "[io][g2o][planar]") {
  const std::string text =
      "VERTEX_SE2 0 -0.0017946 1e-07 0.0174533\nVERTEX_SE2 1 1 0 -2.416141\nVERTEX_SE2 2 1 0 3.14159\n"
      "VERTEX_SE2 3 1 0 1e-09\nEDGE_SE2 0 1 10.245995 0.6475865 -2.416141 5.523667 0 0 5.523667 0 55.23667\n";
  CHECK(written(read(text).graph) == text);
  // Beyond a turn the same pose has a shorter angle.
  CHECK(written(read("VERTEX_SE2 0 0 0 7\n").graph).find("VERTEX_SE2 0 0 0 0.71681469282041") == 0);
}

TEST_CASE("g2o: flaws of 2D graphs are counted", "[io][g2o][planar]") {
  const G2oFile file = read(kTwoVertices + kEdge + kEdge +
                            "VERTEX_SE2 1 1 0.5 0.25\nVERTEX_SE2 2 0 0 0\nVERTEX_SE2 3 0 0 0\n" +
                            "EDGE_SE2 1 2 1 0 0 1 1.000001 0 1 0 1\n" +  // six digits
                            "EDGE_SE2 2 3 1 0 0 1 0 5 1 0 1\n" +         // indefinite
                            "EDGE_SE2 3 0 1 0 0 0 0 0 0 0 0\n" +         // says nothing
                            "EDGE_SE2 1 1 0.01 0 0 1 0 0 1 0 1\n" +      // the place where the robot stands
                            "EDGE_SE2 3 1 1 0 0\n" +                     // no information
                            "VERTEX_XY 9 1 2\nEDGE_SE2_XY 0 9 1 2 1 0 1\n" +
                            "EDGE_SE2 0 9 1 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2 9 0 0 0 1 0 0 1 0 1");
  const Problems& problems = file.problems;
  CHECK(problems.count("repeated edge") == 1);
  CHECK(problems.count("repeated vertex") == 1);
  CHECK(problems.count("rounded information") == 1);
  CHECK(problems.count("indefinite information") == 1);
  CHECK(problems.count("edge of zero information left out") == 1);
  CHECK(problems.count("edge from a vertex to itself left out") == 1);
  CHECK(problems.count("edge without information") == 1);
  CHECK(problems.count("unknown tag VERTEX_XY") == 1);
  CHECK(problems.count("unknown tag EDGE_SE2_XY") == 1);
  CHECK(problems.count("EDGE_SE2 of VERTEX_XY left out") == 1);
  CHECK(problems.count("EDGE_PRIOR_SE2 of VERTEX_XY left out") == 1);
  CHECK(problems.count("no line end after the last line") == 1);
  CHECK(problems.all().size() == 12);
  REQUIRE(file.graph.edges().size() == 5);
  for (const Edge& edge : file.graph.edges()) {
    CHECK(planar::is_information(edge.information));
    CHECK(check_information(edge.information) == nullptr);
  }
  CHECK(file.without_information == std::vector<std::size_t>{4});
}

TEST_CASE("g2o: unreadable lines of 2D graphs are refused with their number", "[io][g2o][planar][error]") {
  struct Bad {
    std::string text;
    std::string message;
  };
  const Bad bad = GENERATE_COPY(values<Bad>({
      {kTwoVertices + kSpatialVertex,
       ":3: VERTEX_SE3:QUAT in the file of a 2D graph (VERTEX_SE2 in line 1): write 2D and 3D graphs to "
       "separate files"},
      {kSpatialVertex + kEdge, ":2: EDGE_SE2 in the file of a 3D graph (VERTEX_SE3:QUAT in line 1)"},
      {"EDGE_PRIOR_SE2 1 0 0 0 1 0 0 1 0 1\nPARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n",
       ":2: PARAMS_SE3OFFSET in the file of a 2D graph"},
      {"VERTEX_SE2 0 0 0\n", ":1: VERTEX_SE2 needs 3 values after the id, found 2"},
      {"VERTEX_SE2 0 0 0 0 0\n", ":1: VERTEX_SE2 needs 3 values after the id, found 4"},
      {"VERTEX_SE2 0 0 nan 0\n", ":1: \"nan\" is not finite"},
      {kTwoVertices + "VERTEX_SE2 1 2 0 0\n", ":3: vertex 1 has another pose in line 2"},
      {kTwoVertices + "EDGE_SE2 0 2 0 0 0 1 0 0 1 0 1\n", ":3: node 2 is not in the graph"},
      {kTwoVertices + "EDGE_SE2 5 5 0 0 0 1 0 0 1 0 1\n", ":3: node 5 is not in the graph"},
      {kTwoVertices + "EDGE_SE2 0 1 0 0 0 1 0\n",
       ":3: EDGE_SE2 needs 9 values after the ids (3 of the pose, 6 of the information) or the 3 alone, "
       "found "
       "5"},
      {kTwoVertices + kEdge + "EDGE_SE2 0 1 0 0 0", ":4: EDGE_SE2 needs 9 values after the ids as the other"},
      {kTwoVertices + "EDGE_PRIOR_SE2 0 0 0 0 1\n",
       ":3: EDGE_PRIOR_SE2 needs 9 values after the id (3 of the pose, 6 of the information), found 4"},
      {"VERTEX2 0 0 0 0\n", ":1: VERTEX2: programs differ"},
      {kTwoVertices + "EDGE2 0 1 0 0 0 1 0 1 1 0 0\n", ":3: EDGE2: programs differ"},
  }));
  CAPTURE(bad.text);
  CHECK_THROWS_AS(read(bad.text), InputError);
  CHECK_THROWS_WITH(read(bad.text), Contains(bad.message) && Contains("run.g2o"));
}

TEST_CASE("g2o: a 2D graph stays planar as a mission and in other forms", "[io][g2o][planar]") {
  const TemporaryFolder folder;
  const PoseGraph graph = drive(12, 5);
  write_g2o(folder / "in.g2o", graph);
  const Mission mission = read_mission(folder / "in.g2o");
  REQUIRE(mission.graph.planar());
  for (const MissionFormat format : {MissionFormat::kMission, MissionFormat::kG2oPcd}) {
    const auto out = folder / enum_name(format);
    static_cast<void>(convert_mission(mission, out, format));
    const Mission back = read_mission(out);
    REQUIRE(back.graph.planar());
    CHECK(back.graph.edges().size() == graph.edges().size());
    CHECK(back.graph.priors().size() == 1);
  }
  const std::vector<std::filesystem::path> two = {folder / "in.g2o", folder / "in.g2o"};
  CHECK_THROWS_WITH(read_missions(two), Contains("in.g2o: has a 2D graph"));
}

TEST_CASE("g2o: the published 2D graphs read and round-trip", "[io][g2o][planar][data]") {
  const auto folder = testing::test_data("rrr");
  if (!folder) return;
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(*folder)) {
    if (entry.path().extension() != ".g2o") continue;
    CAPTURE(entry.path().string());
    ++files;
    const G2oFile a = read_g2o(entry.path());
    REQUIRE(a.graph.planar());
    const std::string text = written(a.graph);
    const G2oFile b = read(text);
    CHECK(b.graph.keys() == a.graph.keys());
    CHECK(b.graph.edges().size() == a.graph.edges().size());
    CHECK(written(b.graph) == text);
    for (std::size_t i = 0; i < a.graph.nodes().size(); ++i)
      REQUIRE(a.graph.nodes()[i].pose.matrix() == b.graph.nodes()[i].pose.matrix());
  }
  CHECK(files > 0);
}

}  // namespace loopwise::g2o_planar_test
