// SPDX-License-Identifier: BSD-3-Clause
// Databases of RTAB-Map, as Python's sqlite3 and zlib make them after its sources.
#include <cstdlib>
#include <fstream>

#include <loopwise/core/error.hpp>

#include "inflate.hpp"
#include "lamp_testing.hpp"

namespace loopwise::rtabmap_test {
namespace {

namespace fs = std::filesystem;
using testing::TemporaryFolder;

bool rtabmap_data(const fs::path& file, const std::string& arguments = {}) {
  if (!bags::rosbag2_available()) {
    SUCCEED("skipped");
    return false;
  }
  const std::string command = std::string(testing::kPython) + " '" + LOOPWISE_SOURCE_DIR +
                              "/tests/io/rtabmap_data.py' '" + file.string() + "' " + arguments;
  REQUIRE(std::system(command.c_str()) == 0);
  return true;
}

Json expected_of(const fs::path& file) {
  return parse_json(read_file(file.string() + ".json"), "expected");
}

Eigen::Isometry3d rows_of(const Json& numbers) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (int i = 0; i < 12; ++i) T(i / 4, i % 4) = numbers[static_cast<std::size_t>(i)].get<double>();
  return T;
}

constexpr double kFloat = 1e-5;  // poses are stored in floats; measured 4e-7 m, and composed along the path

TEST_CASE("RTAB-Map: nodes, odometry, closures, scans and optimised poses of its database",
          "[io][saved_map][rtabmap]") {
  const TemporaryFolder folder;
  const fs::path file = folder / "lab.db";
  const std::string level = GENERATE("--level -1", "--level 0", "--level 1", "--level 9 --points 3000");
  CAPTURE(level);
  if (!rtabmap_data(file, level)) return;
  const Json expected = expected_of(file);
  CHECK(mission_kind(file) == MissionKind::kRtabmap);
  CHECK(mission_kind(folder.path()) == MissionKind::kRtabmap);
  const Mission mission = read_mission(folder.path());
  for (const Problem& problem : mission.problems.all()) FAIL_CHECK(to_string(problem));
  REQUIRE(mission.robots.size() == 1);
  REQUIRE(mission.graph.nodes().size() == 6);
  const Eigen::Isometry3d first = rows_of(expected["nodes"][0]["odometry"]);
  for (const Json& node : expected["nodes"]) {
    const Key key = node["id"].get<Key>();
    const Eigen::Isometry3d stands =
        rows_of(expected["nodes"][0]["optimized"]) * first.inverse() * rows_of(node["odometry"]);
    CHECK(mission.graph.node(key).pose.isApprox(stands, kFloat));
    CHECK(mission.reference.at(key).isApprox(rows_of(node["optimized"]), kFloat));
    CHECK(mission.graph.node(key).stamp_ns == std::llround(node["stamp"].get<double>() * 1e9));
  }
  const Edge& closure = mission.graph.edges().back();
  const auto optimized = [&](Key key) { return rows_of(expected["nodes"][key - 1]["optimized"]); };
  CHECK(closure.T_from_to.isApprox(optimized(closure.from).inverse() * optimized(closure.to), kFloat));
  std::size_t odometry = 0;
  for (const Edge& edge : mission.graph.edges()) {
    odometry += edge.kind == EdgeKind::kOdometry ? 1 : 0;
    CHECK(edge.information(2, 2) == 50.0);
    CHECK(edge.information(5, 5) == 500.0);
  }
  CHECK(odometry == 5);
  CHECK(mission.graph.edges().size() == 6);  // both nodes of a link store it
  const auto scan = mission.scans->load(3);
  REQUIRE(scan);
  CHECK(scan->size() >= 50);
  const Eigen::Vector3d p(1.25, std::sin(0.3 + 2.0), 0.5);
  CHECK((scan->points[1].cast<double>() - rows_of(expected["lidar"]) * p).norm() < kFloat);
  CHECK(scan->intensities[1] == 1.0F);
}

TEST_CASE("RTAB-Map: each map is a robot at its optimised pose", "[io][saved_map][rtabmap]") {
  const TemporaryFolder folder;
  if (!rtabmap_data(folder / "two.db", "--maps 2 --truth")) return;
  const Json expected = expected_of(folder / "two.db");
  const Mission mission = read_mission(folder / "two.db");
  REQUIRE(testing::names_of(mission.robots) == std::vector<std::string>{"two_0", "two_1"});
  CHECK(mission.problems.count("joined without a frame") == 0);
  CHECK(mission.graph.node(7).pose.isApprox(rows_of(expected["nodes"][6]["optimized"]), kFloat));
  // The truth of the database is in the frame of the system that measured it.
  CHECK(mission.truth_is_aligned);
  CHECK(mission.problems.count("truth in another frame") == 1);
  CHECK(mission.ground_truth.size() == 12);
  CHECK((mission.ground_truth.at(1).translation() - mission.graph.node(1).pose.translation()).norm() < 0.5);

  REQUIRE(rtabmap_data(folder / "bare.db", "--maps 2 --no-optimized"));
  const Mission bare = read_mission(folder / "bare.db");
  CHECK(bare.problems.count("joined without a frame") == 2);
  CHECK(bare.reference.empty());
}

TEST_CASE("RTAB-Map: a closure between two nodes in a row is not their odometry",
          "[io][saved_map][rtabmap]") {
  const TemporaryFolder folder;
  if (!rtabmap_data(folder / "lab.db", "--false-closure")) return;
  const Json expected = expected_of(folder / "lab.db");
  const Mission mission = read_mission(folder / "lab.db");
  CHECK(mission.problems.count("odometry without a link taken from the nodes") == 1);
  const auto odometry = [&](std::size_t i) { return rows_of(expected["nodes"][i]["odometry"]); };
  const Eigen::Isometry3d step = mission.graph.node(3).pose.inverse() * mission.graph.node(4).pose;
  CHECK(step.isApprox(odometry(2).inverse() * odometry(3), kFloat));
  std::size_t steps = 0;
  for (const Edge& edge : mission.graph.edges()) {
    steps += edge.kind == EdgeKind::kOdometry ? 1 : 0;
    if (edge.T_from_to.translation().norm() > 5.0 && edge.from + edge.to == 7 &&
        std::min(edge.from, edge.to) == 3)
      CHECK(edge.kind == EdgeKind::kLoopClosure);
  }
  CHECK(steps == 5);
}

TEST_CASE("RTAB-Map: without its first node a map gets its pose from the next", "[io][saved_map][rtabmap]") {
  const TemporaryFolder folder;
  if (!rtabmap_data(folder / "two.db", "--maps 2 --late-start")) return;
  const Json expected = expected_of(folder / "two.db");
  const Mission mission = read_mission(folder / "two.db");
  CHECK(mission.problems.count("joined without a frame") == 0);
  const auto rows = [&](std::size_t i, const char* name) { return rows_of(expected["nodes"][i][name]); };
  CHECK(mission.graph.node(7).pose.isApprox(
      rows(7, "optimized") * rows(7, "odometry").inverse() * rows(6, "odometry"), kFloat));
  // Other files of a folder come first: programs keep their databases beside them.
  testing::write_text(folder / "graph.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n");
  CHECK(mission_kind(folder.path()) == MissionKind::kG2oPcd);
}

TEST_CASE("RTAB-Map: data that are left out or guessed are counted", "[io][saved_map][rtabmap][error]") {
  const TemporaryFolder folder;
  if (!rtabmap_data(folder / "odd.db", "--odd --gap")) return;
  const Mission mission = read_mission(folder / "odd.db");
  CHECK(mission.graph.nodes().size() == 6);
  CHECK(mission.problems.count("prior or gravity of a node left out") == 2);
  CHECK(mission.problems.count("landmark left out") == 1);
  CHECK(mission.problems.count("link of an unsupported type left out") == 1);
  CHECK(mission.problems.count("node without odometry left out") == 2);
  CHECK(mission.problems.count("node without a link left out") == 1);
  CHECK(mission.problems.count("odometry without a link taken from the nodes") == 1);
  CHECK(mission.problems.count("link without a covariance, given that of the options") == 2);
  CHECK(mission.scans->load(1)->size() == 49);
  CHECK(mission.scans->problems().count("point not finite") == 1);

  REQUIRE(rtabmap_data(folder / "flat.db", "--flat"));
  const Mission flat = read_mission(folder / "flat.db");
  CHECK(flat.problems.count("scan of a 2D scanner left out") == 6);
  CHECK(flat.scans->empty());
  REQUIRE(rtabmap_data(folder / "rgbd.db", "--no-scans"));
  CHECK(read_mission(folder / "rgbd.db").problems.count("no lidar scan in the database") == 1);
  REQUIRE_THROWS_WITH(read_mission(folder.path()), Catch::Matchers::Contains("3 databases of RTAB-Map"));
}

TEST_CASE("RTAB-Map: damage is an error that names the file", "[io][saved_map][rtabmap][error]") {
  const TemporaryFolder folder;
  const fs::path file = folder / "lab.db";
  if (!rtabmap_data(file)) return;
  const std::string good = read_file(file);
  const auto sql = [&](const std::string& text) {
    write_file(file, good);
    const std::string command = std::string(testing::kPython) +
                                " -c \"import sqlite3; d = sqlite3.connect('" + file.string() +
                                "'); d.execute('" + text + "'); d.commit()\"";
    REQUIRE(std::system(command.c_str()) == 0);
  };
  write_file(file, good.substr(0, good.size() - 5000));
  REQUIRE_THROWS_WITH(read_mission(file), Catch::Matchers::Contains("cut short"));
  sql("UPDATE Data SET scan = substr(scan, 1, 40) WHERE id = 2");
  REQUIRE_THROWS_WITH(
      read_mission(file).scans->load(2),
      Catch::Matchers::Contains("lab.db: scan of node 2") && Catch::Matchers::Contains("matrix"));
  sql("UPDATE Data SET scan_info = substr(scan_info, 1, 20) WHERE id = 2");
  REQUIRE_THROWS_WITH(read_mission(file), Catch::Matchers::Contains("node 2") &&
                                              Catch::Matchers::Contains("scan_info is cut short"));
  sql("DELETE FROM Node");
  REQUIRE_THROWS_WITH(read_mission(file), Catch::Matchers::Contains("has no node with odometry"));
  sql("ALTER TABLE Link RENAME COLUMN information_matrix TO rot_variance");
  REQUIRE_THROWS_WITH(read_mission(file), Catch::Matchers::Contains("information_matrix"));
  sql("DROP TABLE Data");
  REQUIRE_THROWS_WITH(read_mission(file), Catch::Matchers::Contains("no table Data"));
}

TEST_CASE("zlib: damage and bombs are errors", "[io][inflate][error]") {
  const std::string hello("\x78\x9c\xcb\x48\xcd\xc9\xc9\x07\x00\x06\x2c\x02\x15", 13);  // "hello"
  CHECK(inflate_zlib(hello, 5) == "hello");
  REQUIRE_THROWS_WITH(inflate_zlib(hello, 4), Catch::Matchers::Contains("more than the 4 bytes"));
  for (std::size_t size = 0; size < hello.size(); ++size)
    REQUIRE_THROWS_AS(inflate_zlib(hello.substr(0, size), 5), InputError);
  for (std::size_t at = 0; at < hello.size(); ++at) {
    for (int bit = 0; bit < 8; ++bit) {
      std::string other = hello;
      other[at] = static_cast<char>(other[at] ^ (1 << bit));
      CAPTURE(at, bit);
      // Bits behind the last word of a block have no meaning.
      std::string out = "hello";
      try {
        out = inflate_zlib(other, 5);
      } catch (const InputError&) {
        continue;
      }
      CHECK(out == "hello");
      CHECK(at == 8);
    }
  }
}

}  // namespace
}  // namespace loopwise::rtabmap_test
