// SPDX-License-Identifier: BSD-3-Clause
// Which edges of recordings are odometry, in the forms of several writers.
#include <algorithm>

#include <loopwise/core/error.hpp>
#include <loopwise/io/mission.hpp>

#include "testing.hpp"

namespace loopwise {
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

TEST_CASE("odometry: a list of pairs says which edges it is", "[io][odometry]") {
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

}  // namespace loopwise
