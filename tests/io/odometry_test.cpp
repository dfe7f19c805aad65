// SPDX-License-Identifier: BSD-3-Clause
// Which edges of recordings are odometry, in the forms of several writers.
#include <algorithm>

#include <loopwise/core/error.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>

#include "testing.hpp"

namespace loopwise::odometry_test {
namespace {

using testing::TemporaryFolder;
using testing::fs::path;

const std::string kInformation = " 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 9 0 0 9 0 9\n";

std::string vertex(Key key, double x) {
  return "VERTEX_SE3:QUAT " + std::to_string(key) + " " + std::to_string(x) + " 0 0 0 0 0 1\n";
}

std::string edge(Key from, Key to, double x) {
  return "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) + " " + std::to_string(x) +
         " 0 0 0 0 0 1" + kInformation;
}

/// Four nodes with gaps between their ids, odometry written backwards, and a closure.
std::string path_text() {
  return vertex(5, 0) + vertex(20, 1) + vertex(9, 2) + vertex(40, 3) + edge(9, 5, -1) + edge(20, 9, -1) +
         edge(40, 20, -1) + edge(5, 40, 3);
}

std::size_t odometry_edges(const PoseGraph& graph) {
  return static_cast<std::size_t>(std::count_if(graph.edges().begin(), graph.edges().end(),
                                                [](const Edge& e) { return e.kind == EdgeKind::kOdometry; }));
}

const char* const kBroken = "odometry chain broken";

}  // namespace

TEST_CASE("odometry: of g2o files and mission folders in any direction, over gaps of ids", "[io][odometry]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "g.g2o", path_text());
  testing::fs::create_directory(folder / "m");
  testing::write_text(folder / "m" / "graph.g2o", path_text());
  testing::write_text(folder / "m" / "mission.json", "{\"format\": \"loopwise-mission\", \"version\": 1}");
  for (const path& source : {folder / "g.g2o", folder / "m"}) {
    const Mission mission = read_mission(source);
    CHECK(odometry_edges(mission.graph) == 3);
    CHECK(mission.problems.count(kBroken) == 0);
  }
  // Two robots in it: the edge from one to the other is a closure, and no chain is broken.
  MissionOptions options;
  options.robots = "0-9,10-40";
  const Mission two = read_mission(folder / "g.g2o", options);
  CHECK(odometry_edges(two.graph) == 2);
  CHECK(two.problems.count(kBroken) == 0);
}

TEST_CASE("odometry: a list of pairs selects its edges", "[io][odometry]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "g.g2o", path_text());
  MissionOptions options;
  options.odometry = (folder / "pairs.txt").string();
  testing::write_text(folder / "pairs.txt", "# from to\n5, 9\n5 40\n");
  const Mission mission = read_mission(folder / "g.g2o", options);
  CHECK(odometry_edges(mission.graph) == 2);
  CHECK(mission.graph.edges()[3].kind == EdgeKind::kOdometry);
  CHECK(mission.problems.count(kBroken) == 1);
  testing::write_text(folder / "pairs.txt", "5 9\n5 20\n");
  CHECK_THROWS_WITH(read_mission(folder / "g.g2o", options),
                    Contains("pairs.txt: the graph has no edge between 5 and 20"));
  testing::write_text(folder / "pairs.txt", "5 9\n5\n");
  CHECK_THROWS_WITH(read_mission(folder / "g.g2o", options), Contains("pairs.txt:2: expected two keys"));
  options.odometry = (folder / "absent.txt").string();
  CHECK_THROWS_AS(read_mission(folder / "g.g2o", options), IoError);
}

TEST_CASE("odometry: a session's graph may hold it backwards", "[io][session][odometry]") {
  const TemporaryFolder folder;
  testing::fs::create_directory(folder / "s");
  testing::write_text(folder / "s" / "optimized_poses.txt",
                      "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 2 0 1 0 0 0 0 1 0\n1 0 0 4 0 1 0 0 0 0 1 0\n");
  testing::write_text(folder / "s" / "singlesession_posegraph.g2o",
                      vertex(0, 0) + vertex(1, 0) + vertex(2, 0) + edge(1, 0, -2.5) + edge(1, 2, 2.5));
  const Mission mission = read_mission(folder / "s");
  CHECK(mission.graph.node(2).pose.translation().x() == 5.0);
  CHECK(mission.problems.count("odometry missing in the session's graph") == 0);
  CHECK(mission.problems.count("closure of the session's own graph left out") == 0);
}

TEST_CASE("odometry: edges without information are judged by the sigmas of the options", "[io][odometry]") {
  const TemporaryFolder folder;
  const auto bare = [](Key from, Key to, double x) {
    return "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) + " " + std::to_string(x) +
           " 0 0 0 0 0 1\n";
  };
  const std::string text =
      vertex(0, 0) + vertex(1, 1) + vertex(2, 2) + bare(0, 1, 1) + bare(1, 2, 1.5) + bare(1, 2, 1);
  testing::write_text(folder / "g.g2o", text);
  testing::fs::create_directory(folder / "pcd");
  testing::write_text(folder / "pcd" / "graph.g2o", text);
  const char* const contradicts = "edge that contradicts the odometry, treated as a loop closure";
  MissionOptions loose;
  loose.odometry_sigma_m_per_m = 0.5;
  for (const path& source : {folder / "g.g2o", folder / "pcd"}) {
    const Mission mission = read_mission(source);
    CHECK(mission.problems.count(contradicts) == 1);
    CHECK(mission.graph.edges()[1].kind == EdgeKind::kLoopClosure);
    CHECK(mission.graph.edges()[2].information(0, 0) == Approx(2500.0));
    const Mission vague = read_mission(source, loose);
    CHECK(vague.problems.count(contradicts) == 0);
    CHECK(odometry_edges(vague.graph) == 3);
    CHECK(vague.graph.edges()[2].information(0, 0) == Approx(4.0));
  }
  const G2oFile file = read_g2o(folder / "g.g2o");
  CHECK(file.graph.edges()[1].kind == EdgeKind::kLoopClosure);

  testing::fs::create_directory(folder / "s");
  testing::write_text(folder / "s" / "optimized_poses.txt",
                      "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n1 0 0 2 0 1 0 0 0 0 1 0\n");
  testing::write_text(folder / "s" / "singlesession_posegraph.g2o", text);
  const Mission session = read_mission(folder / "s");
  CHECK(session.graph.node(2).pose.translation().x() == Approx(2.0));
  CHECK(session.problems.count("edge that contradicts the session's odometry left out") == 1);
  CHECK(session.problems.count("closure of the session's own graph left out") == 0);
  const Mission vague = read_mission(folder / "s", loose);
  CHECK(vague.problems.count("repeated odometry of the session's graph left out") == 1);
  CHECK(vague.problems.count("closure of the session's own graph left out") == 0);
}

TEST_CASE("odometry: conversion and joining keep a list", "[io][convert][odometry]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "g.g2o", path_text());
  testing::write_text(folder / "pairs.txt", "5 9\n5 40\n20 40\n");
  MissionOptions options;
  options.odometry = (folder / "pairs.txt").string();
  const Mission mission = read_mission(folder / "g.g2o", options);
  for (const MissionFormat format : {MissionFormat::kMission, MissionFormat::kG2oPcd}) {
    const path out = folder / enum_name(format);
    const ConvertResult result = convert_mission(mission, out, format);
    CHECK(result.left_out.count("kind of an edge left out") == 0);
    const Mission read = read_mission(out);
    CHECK(read.problems.count("foreign file in scans") == 0);
    REQUIRE(read.graph.edges().size() == 4);
    for (std::size_t e = 0; e < 4; ++e) CHECK(read.graph.edges()[e].kind == mission.graph.edges()[e].kind);
    MissionOptions all = options;  // the command line comes first
    all.odometry = (folder / "all.txt").string();
    testing::write_text(folder / "all.txt", "5 9\n9 20\n20 40\n");
    CHECK(read_mission(out, all).graph.edges()[3].kind == EdgeKind::kLoopClosure);
    const Mission joined = read_missions({out, folder / "g.g2o"});
    CHECK(joined.graph.edges()[3].kind == EdgeKind::kOdometry);
    CHECK(joined.graph.edges()[7].kind == EdgeKind::kLoopClosure);
  }
  // Neighbours determine it: no list.
  write_mission(folder / "plain", read_mission(folder / "g.g2o"));
  CHECK_FALSE(testing::fs::exists(folder / "plain" / "odometry.csv"));
  // Of two edges between the same nodes no list says which is odometry.
  Mission other = mission;
  Edge again = other.graph.edges()[0];
  again.kind = EdgeKind::kLoopClosure;
  other.graph.add_edge(again);
  CHECK(convert_mission(other, folder / "two", MissionFormat::kMission)
            .left_out.count("kind of an edge left out") == 1);
}

TEST_CASE("odometry: of joined sources a broken chain counts once", "[io][mission][odometry]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "one.g2o", path_text());
  testing::write_text(folder / "two.g2o", vertex(1, 0) + vertex(2, 1) + vertex(3, 2) + edge(3, 2, -1));
  MissionOptions options;
  const Mission mission = read_missions({folder / "one.g2o", folder / "two.g2o"}, options);
  CHECK(odometry_edges(mission.graph) == 4);
  CHECK(mission.problems.count(kBroken) == 1);
}

TEST_CASE("odometry: reversed edges and gaps of ids in missions of others", "[io][odometry][data]") {
  for (const char* name : {"odometry_reversed", "odometry_id_gaps"}) {
    const auto folder = testing::test_data("../cases/" + std::string(name));
    if (!folder) return;
    CAPTURE(name);
    const Mission mission = read_mission(*folder);
    CHECK(odometry_edges(mission.graph) == mission.graph.nodes().size() - 1);
    CHECK(mission.problems.count(kBroken) == 0);
  }
}

}  // namespace loopwise::odometry_test
