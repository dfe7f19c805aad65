// SPDX-License-Identifier: BSD-3-Clause
// Bags of ROS 2 with LAMP's graphs, as sqlite3 and a writer of MCAP in Python make them.
#include <atomic>
#include <thread>

#include <loopwise/core/error.hpp>

#include "lamp_testing.hpp"

namespace loopwise::rosbag2_test {
namespace {

namespace fs = std::filesystem;
using testing::expected_of;
using testing::rosbag2_data;
using testing::TemporaryFolder;

void check_tunnel(const Mission& mission, const Json& expected) {
  CHECK(mission.kind == MissionKind::kBags);
  CHECK(testing::names_of(mission.robots) == std::vector<std::string>{"husky3", "spot1"});
  testing::check_nodes(mission, expected);
  CHECK(mission.graph.edges().size() == expected["edges"].size());
  testing::check_odometry(mission, expected);
  testing::check_priors(mission, expected);
  testing::check_scans(mission, expected);
  testing::check_truth(mission, expected);
}

TEST_CASE("rosbag2: LAMP's graphs and scans from both storages, with any packing", "[io][bag][rosbag2]") {
  const TemporaryFolder folder;
  const std::string arguments = GENERATE(
      "--storage mcap", "--storage mcap --pack zstd --definitions", "--storage mcap --pack lz4 --big-endian",
      "--storage mcap --unchunked --no-summary", "--storage mcap --pack message --metadata --split 5",
      "--storage mcap --pack file --metadata", "--storage db3", "--storage db3 --definitions --big-endian",
      "--storage db3 --pack message --metadata", "--storage db3 --pack file --metadata --split 4",
      "--storage db3 --split 4");
  CAPTURE(arguments);
  if (!rosbag2_data("bags", folder / "tunnel", arguments)) return;
  const Json expected = expected_of(folder / "tunnel");
  const Mission mission = read_mission(folder / "tunnel" / "rosbag");
  for (const Problem& problem : mission.problems.all()) FAIL_CHECK(to_string(problem));
  CHECK(mission.name == "tunnel");
  check_tunnel(mission, expected);
  REQUIRE(mission.topics.size() == 6);
  CHECK(mission.topics[0].name == "/husky3/lamp/keyed_scans");
  CHECK(mission.topics[0].type == "pose_graph_msgs/KeyedScan");
  CHECK(mission.topics[0].messages == 6);
  CHECK(mission.topics[0].use == "scans of nodes");
  CHECK(mission.topics[2].use == "true poses");
  CHECK(read_mission(folder / "tunnel").graph.keys() == mission.graph.keys());
}

TEST_CASE("rosbag2: a file, its folder and its metadata are the same recording", "[io][bag][rosbag2]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("bags", folder / "t", "--robots c --metadata --split 4")) return;
  const fs::path bag = folder / "t" / "rosbag" / "husky3";
  const auto keys = read_mission(bag).graph.keys();
  CHECK(keys.size() == 6);
  CHECK(mission_kind(bag) == MissionKind::kBags);
  CHECK(read_mission(bag / "metadata.yaml").graph.keys() == keys);
  CHECK(read_mission(bag / "husky3_0.mcap").graph.keys().size() < keys.size());

  SECTION("a listed file that is missing is an error, one that is not listed is counted") {
    fs::rename(bag / "husky3_1.mcap", bag / "husky3_7.mcap");
    CHECK_THROWS_WITH(read_mission(bag),
                      Contains("metadata.yaml: lists \"husky3_1.mcap\", which is missing"));
    testing::write_text(bag / "metadata.yaml",
                        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - old/husky3_0.mcap\n"
                        "    - \"husky3_2.mcap\"\n  duration: 1\n");
    const Mission rest = read_mission(bag);
    CHECK(rest.problems.count("bag not listed in metadata.yaml left out") == 2);
    fs::remove(bag / "metadata.yaml");
    CHECK(read_mission(bag).graph.keys() == keys);
  }
  SECTION("metadata that names no bags is an error with its line") {
    testing::write_text(bag / "metadata.yaml",
                        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - ../../etc/passwd\n");
    CHECK_THROWS_WITH(read_mission(bag), Contains("metadata.yaml:3"));
  }
}

TEST_CASE("rosbag2: radio needs the definitions in the bag", "[io][bag][rosbag2]") {
  const TemporaryFolder folder;
  const bool definitions = GENERATE(true, false);
  CAPTURE(definitions);
  if (!rosbag2_data("base", folder / "b", definitions ? "--definitions" : "--storage db3")) return;
  const Json expected = expected_of(folder / "b");
  const Mission mission = read_mission(folder / "b");
  testing::check_nodes(mission, expected);
  testing::check_odometry(mission, expected);
  testing::check_scans(mission, expected);
  testing::check_edge(mission, expected["closure"], EdgeKind::kLoopClosure);
  CHECK(mission.graph.gravities().size() == 1);
  CHECK(mission.beacons.size() == 1);
  CHECK(mission.radio.size() == (definitions ? 4 : 0));
  CHECK(mission.problems.count("topic without message definition left out") == (definitions ? 0 : 1));
}

TEST_CASE("rosbag2: other encodings are named", "[io][bag][rosbag2][error]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("bags", folder / "t", "--robots c --encoding json")) return;
  CHECK_THROWS_WITH(read_mission(folder / "t" / "rosbag"),
                    Contains("husky3.mcap") && Contains("no pose graph"));
}

TEST_CASE("rosbag2: other databases and mixtures", "[io][bag][rosbag2][error]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("bags", folder / "t", "--robots c --storage db3")) return;
  const std::string sql =
      "sqlite3.connect('" + (folder / "other.db3").string() + "').execute('CREATE TABLE a(b)')";
  REQUIRE(std::system((std::string(testing::kPython) + " -c \"import sqlite3; " + sql + "\"").c_str()) == 0);
  CHECK_THROWS_WITH(read_mission(folder / "other.db3"),
                    Contains("other.db3: an SQLite database without the tables messages and topics"));
  // A view that never ends is not asked.
  const fs::path endless = folder / "endless.db3";
  const std::string view =
      "d=sqlite3.connect('" + endless.string() +
      "'); d.execute('CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)'); "
      "d.execute('CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) "
      "SELECT x AS topic_id, x AS timestamp, x AS data FROM c'); d.commit()";
  REQUIRE(std::system((std::string(testing::kPython) + " -c \"import sqlite3; " + view + "\"").c_str()) == 0);
  CHECK_THROWS_WITH(read_mission(endless), Contains("without the tables"));
  // Bags of ROS 1 beside those of ROS 2.
  if (!testing::lamp_data("bags", folder / "u", "--robots e")) return;
  const Mission both =
      read_missions({folder / "t" / "rosbag" / "husky3.db3", folder / "u" / "rosbag" / "spot1.bag"});
  CHECK(both.graph.nodes().size() == 12);
  CHECK(both.scans->size() == 12);
}

TEST_CASE("rosbag2: scans are read by many threads at once", "[io][bag][rosbag2][thread]") {
  const TemporaryFolder folder;
  const std::string storage = GENERATE("mcap --pack zstd", "db3");
  if (!rosbag2_data("bags", folder / "t", "--nodes 10 --storage " + storage)) return;
  const Json expected = expected_of(folder / "t");
  MissionOptions options;
  options.scan_cache_mb = 0.0;  // each load goes to the bags
  const Mission mission = read_mission(folder / "t" / "rosbag", options);
  const std::vector<Key> keys = mission.scans->keys();
  std::vector<std::thread> threads;
  std::atomic<int> wrong{0};
  for (unsigned t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      Rng rng(t);
      for (int i = 0; i < 50; ++i) {
        const Key key = keys[rng.below(keys.size())];
        const auto cloud = mission.scans->load(key);
        if (cloud->points[3].x() != expected["scans"][std::to_string(key)]["points"][3][0].get<float>())
          ++wrong;
      }
    });
  }
  for (auto& thread : threads) thread.join();
  CHECK(wrong == 0);
}

}  // namespace
}  // namespace loopwise::rosbag2_test
