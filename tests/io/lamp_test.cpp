// SPDX-License-Identifier: BSD-3-Clause
// LAMP's bags and saved maps and the g2o_pcd folders of its data, as other writers make them.
#include <algorithm>
#include <thread>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>

#include "lamp_testing.hpp"
#include "mission_parts.hpp"

namespace loopwise::lamp_test {
namespace {

namespace fs = std::filesystem;
using testing::check_information;
using testing::check_nodes;
using testing::check_odometry;
using testing::check_optimum;
using testing::check_priors;
using testing::check_scans;
using testing::check_truth;
using testing::covariance_of;
using testing::expected_of;
using testing::find_edge;
using testing::key_of;
using testing::lamp_data;
using testing::names_of;
using testing::pose_of;
using testing::TemporaryFolder;

std::vector<std::string> kinds_of(const Problems& problems) {
  std::vector<std::string> kinds;
  for (const Problem& problem : problems.all()) kinds.push_back(problem.kind);
  std::sort(kinds.begin(), kinds.end());
  return kinds;
}

Problem problem_of(const Problems& problems, const std::string& kind) {
  for (const Problem& problem : problems.all()) {
    if (problem.kind == kind) return problem;
  }
  return {};
}

TEST_CASE("bags: robots' recordings and their truth, in every compression", "[io][bag]") {
  const TemporaryFolder folder;
  const std::string compression = GENERATE("none", "bz2", "lz4");
  CAPTURE(compression);
  // Chunks of a few messages each: many of them.
  if (!lamp_data("bags", folder / "tunnel", "--compression " + compression + " --chunk 4000")) return;
  const Json expected = expected_of(folder / "tunnel");
  const Mission mission = read_mission(folder / "tunnel" / "rosbag");
  CHECK(kinds_of(mission.problems).empty());
  CHECK(mission.kind == MissionKind::kBags);
  CHECK(mission.name == "tunnel");
  CHECK(names_of(mission.robots) == std::vector<std::string>{"husky3", "spot1"});
  CHECK(key_character(mission.robots[0].first) == 'c');
  CHECK(std::to_string(mission.start_ns) == expected["nodes"][0]["stamp_ns"]);
  check_nodes(mission, expected);
  CHECK(mission.graph.edges().size() == expected["edges"].size());
  check_odometry(mission, expected);
  check_priors(mission, expected);
  check_scans(mission, expected);
  check_truth(mission, expected);
  CHECK_THAT(mission.provenance_json, Contains("husky3.bag") && !Contains(folder.path().string()));

  // The folder around, a single bag, and several.
  CHECK(read_mission(folder / "tunnel").graph.keys() == mission.graph.keys());
  const fs::path one = folder / "tunnel" / "rosbag" / "husky3.bag",
                 other = folder / "tunnel" / "rosbag" / "spot1.bag";
  const Mission alone = read_mission(one);
  CHECK(alone.graph.nodes().size() == 6);
  CHECK(alone.ground_truth.size() == 6);
  CHECK(alone.problems.count("ground truth of an unknown robot") == 1);
  CHECK(names_of(alone.robots) == std::vector<std::string>{"husky3"});
  const Mission both = read_missions({other, one});
  CHECK(both.graph.keys() == mission.graph.keys());
  CHECK(both.ground_truth.size() == 12);
  CHECK(both.name == "spot1+1");
}

TEST_CASE("bags: a recording in parts is read as one", "[io][bag]") {
  const TemporaryFolder folder;
  if (!lamp_data("split", folder / "s", "--nodes 9")) return;
  const Json expected = expected_of(folder / "s");
  const Mission mission = read_mission(folder / "s" / "rosbag");
  check_nodes(mission, expected);
  check_odometry(mission, expected);
  check_scans(mission, expected);
  CHECK(mission.problems.empty());
  // Both orders of naming them give the same.
  const fs::path a = folder / "s" / "rosbag" / "husky3_0.bag", b = folder / "s" / "rosbag" / "husky3_1.bag";
  for (const auto& paths : {std::vector<fs::path>{a, b}, std::vector<fs::path>{b, a}}) {
    const Mission again = read_missions(paths);
    CHECK(again.graph.keys() == mission.graph.keys());
    CHECK(again.graph.edges().size() == mission.graph.edges().size());
  }
}

TEST_CASE("bags: a base station's graphs, closures, other factors and radio", "[io][bag]") {
  const TemporaryFolder folder;
  if (!lamp_data("base", folder / "b")) return;
  const Json expected = expected_of(folder / "b");
  const Mission mission = read_mission(folder / "b");
  CHECK(names_of(mission.robots) == std::vector<std::string>{"husky3_artifacts", "husky3", "spot1"});
  check_nodes(mission, expected);  // the first estimates, not the optimiser's
  check_odometry(mission, expected);
  check_priors(mission, expected);
  check_scans(mission, expected);
  REQUIRE(mission.graph.edges().size() == expected["edges"].size() + 2);
  testing::check_edge(mission, expected["closure"], EdgeKind::kLoopClosure);
  CHECK(mission.robots[0].landmarks);
  CHECK(mission.graph.edges().back().kind == EdgeKind::kLandmark);
  CHECK(mission.graph.edges().back().to == make_key('C', 0));
  REQUIRE(mission.graph.gravities().size() == 1);
  CHECK(mission.graph.gravities()[0].key == make_key('c', 2));
  CHECK(mission.graph.gravities()[0].direction == -Eigen::Vector3d::UnitZ());
  CHECK(mission.graph.gravities()[0].sigma_rad == 0.05);

  const Key c2 = make_key('c', 2);
  REQUIRE(mission.beacons.size() == 1);
  CHECK(mission.beacons[0].beacon == "beacon7");
  CHECK(mission.beacons[0].robot == 1);
  CHECK(mission.beacons[0].drop_key == c2);
  CHECK(mission.beacons[0].stamp_ns == 1'600'000'005'000'000'000);
  // Readings at 6.1 s and 6.9 s are nearest to the nodes at 6 s, that at 8.05 s to the one at 8 s.
  REQUIRE(mission.radio.size() == 4);
  CHECK(mission.radio[0].key == make_key('c', 3));
  CHECK(mission.radio[0].beacon == "beacon7");
  CHECK(mission.radio[0].transmit_dbm == 28.5);
  CHECK(mission.radio[0].receive_dbm == -25.0);
  CHECK(mission.radio[1].receiver == "1");
  CHECK(mission.radio[1].receive_dbm == -27.0);
  CHECK(mission.radio[2].key == make_key('c', 4));
  CHECK(mission.radio[2].receive_dbm == -60.0);

  CHECK(kinds_of(mission.problems) ==
        std::vector<std::string>{"beacon drop without node", "edge of unknown type left out",
                                 "landmark left out", "radio reading of a beacon that was not dropped",
                                 "range factor of a landmark left out",
                                 "repeated radio reading of a node, the nearest in time is used"});
}

TEST_CASE("bags: ranges, gravity, artifacts and anchors give the expected optimum", "[io][bag]") {
  const TemporaryFolder folder;
  if (!lamp_data("factors", folder / "f")) return;
  const Json expected = expected_of(folder / "f");
  MissionOptions options;
  if (GENERATE(false, true)) options.robots = "a,c,e";  // landmarks need not be listed
  const Mission mission = read_mission(folder / "f", options);
  const Problems& problems = mission.problems;
  CHECK(names_of(mission.robots) == std::vector<std::string>{"e_artifacts", "a", "c", "e", "uwb_anchors"});
  check_nodes(mission, expected);
  CHECK(mission.graph.nodes().size() == expected["nodes"].size() + 5);
  for (const char* name : {"u0", "u1", "u3", "E0", "E1"}) CHECK(mission.robots.is_landmark(parse_key(name)));
  CHECK_FALSE(mission.graph.contains(parse_key("u2")));
  CHECK(mission.graph.ranges().size() == 9);
  CHECK(mission.graph.gravities().size() == 1);
  CHECK(mission.graph.priors().size() == 5);  // of three robots, u3, and u1, which has nothing else
  CHECK(std::count_if(mission.graph.edges().begin(), mission.graph.edges().end(),
                      [](const Edge& edge) { return edge.kind == EdgeKind::kLandmark; }) == 5);
  CHECK(problems.count("covariance absent") == 3);
  CHECK(problems.count("unusable range factor") == 4);
  CHECK(problems.count("edge without node") == 1);
  CHECK(problems.count("range factor of a landmark left out") == 1);
  CHECK(problems.count("landmark left out") == 1);
  CHECK(problems.count("landmark with ranges only, given a prior") == 1);
  CHECK(problems.count("unusable gravity factor") == 2);
  CHECK(problems.count("gravity factor that points up left out") == 1);
  CHECK(problems.count("repeated edge with other numbers") == 1);
  CHECK(problems.all().size() == 9);
  // As the message says, but not before the first node that saw it.
  const auto stamp = [&](const char* name) { return mission.graph.node(parse_key(name)).stamp_ns; };
  CHECK(stamp("u0") == stamp("c0"));
  CHECK(stamp("u1") == 1'600'003'600'000'000'000);
  CHECK(stamp("E0") == stamp("e1"));
  CHECK(stamp("E1") == stamp("e2"));
  check_optimum(mission, expected);
}

TEST_CASE("bags: missing values of a message are supplied or left out, and counted", "[io][bag]") {
  const TemporaryFolder folder;
  if (!lamp_data("odd", folder / "o")) return;
  const Json expected = expected_of(folder / "o");
  MissionOptions options;
  const Mission mission = read_mission(folder / "o" / "odd.bag", options);
  const Problems& problems = mission.problems;
  CHECK(mission.graph.nodes().size() == 6);
  CHECK(problems.count("node without stamp") == 1);
  CHECK(mission.graph.node(make_key('c', 3)).stamp_ns == 1'600'000'000'000'000'000);  // the record's
  CHECK(problems.count("node without usable pose") == 1);
  CHECK(problems.count("covariance absent") == 2);  // that of an edge without node has not been looked at
  CHECK(problems.count("unusable covariance") == 1);
  CHECK(problems.count("odometry covariance looks swapped") == 1);
  CHECK(problems.count("repeated edge with other numbers") == 2);
  CHECK(problems.count("edge without pose") == 1);
  CHECK(problems.count("edge without node") == 1);
  CHECK(problems.count("unusable edge") == 1);
  CHECK(problems.count("odometry not between consecutive nodes") == 1);
  CHECK(problems.count("message cannot be read") == 3);
  CHECK(problems.count("repeated scan") == 1);
  CHECK(problems.count("odometry messages not used") == 1);
  CHECK(problems.count("no prior given") == 0);
  CHECK(mission.scans->keys() == std::vector<Key>{make_key('c', 0), make_key('c', 4)});
  CHECK(mission.ground_truth.empty());

  const Edge* const given = find_edge(mission.graph, make_key('c', 0), make_key('c', 1));
  REQUIRE(given != nullptr);
  CHECK(given->information.isApprox(odometry_information(given->T_from_to, options)));
  // The halves are taken as they stand, or the other way round if the caller says so.
  const Edge* const first = find_edge(mission.graph, make_key('c', 1), make_key('c', 2));
  CHECK(first->information(0, 0) == Approx(1.0 / (0.002 * 0.002)));
  CHECK(first->information(3, 3) == Approx(1.0 / (0.05 * 0.05)));
  options.odometry_covariance_order = CovarianceOrder::kTranslationFirst;
  const Mission other = read_mission(folder / "o" / "odd.bag", options);
  CHECK_THAT(to_string(problem_of(problems, "odometry covariance looks swapped")), Contains("c1 to c2"));
  CHECK_THAT(to_string(problem_of(other.problems, "odometry covariance looks swapped")),
             Contains("c0 to c2"));
  const Edge* const swapped = find_edge(other.graph, make_key('c', 1), make_key('c', 2));
  CHECK(swapped->information(0, 0) == Approx(1.0 / (0.05 * 0.05)));
  CHECK(swapped->information(3, 3) == Approx(1.0 / (0.002 * 0.002)));
}

TEST_CASE("bags: scans are read by many threads at once", "[io][bag][thread]") {
  const TemporaryFolder folder;
  if (!lamp_data("bags", folder / "t", "--nodes 10 --compression lz4 --chunk 3000")) return;
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
      for (int i = 0; i < 100; ++i) {
        const Key key = keys[rng.below(keys.size())];
        const auto cloud = mission.scans->load(key);
        const Json& points = expected["scans"][std::to_string(key)]["points"];
        if (cloud->points[3].x() != points[3][0].get<float>()) ++wrong;
      }
    });
  }
  for (auto& thread : threads) thread.join();
  CHECK(wrong == 0);
}

TEST_CASE("bags: reports progress and obeys a stop request", "[io][bag]") {
  const TemporaryFolder folder;
  if (!lamp_data("bags", folder / "p", "--robots c")) return;
  std::vector<Progress> reports;
  static_cast<void>(
      read_mission(folder / "p" / "rosbag", {}, [&](const Progress& p) { reports.push_back(p); }));
  REQUIRE_FALSE(reports.empty());
  CHECK_THAT(reports.front().stage, Contains("checking"));
  CHECK_THAT(reports.back().stage, Contains("reading"));
  CHECK(reports.back().done == reports.back().total);
  const StopSource stop;
  stop.request_stop();
  CHECK_THROWS_AS(read_mission(folder / "p" / "rosbag", {}, {}, stop.token()), StoppedError);
}

TEST_CASE("bags: old, truncated and missing bags are refused", "[io][bag][error]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "old.bag", "#ROSBAG V1.2\n");
  testing::write_text(folder / "cut.bag", "#ROSBAG V2.0\n");
  if (!bags::available()) {
    CHECK_THROWS_WITH(read_mission(folder / "cut.bag"), Contains("built without ROS bags"));
    return;
  }
  CHECK(mission_kind(folder / "old.bag") == MissionKind::kBags);
  CHECK_THROWS_WITH(read_mission(folder / "old.bag"), Contains("old.bag") && Contains("rosbag fix"));
  CHECK_THROWS_WITH(read_mission(folder / "cut.bag"), Contains("cut.bag: byte 13"));
  CHECK_THROWS_WITH(read_missions({folder / "old.bag", folder / "none"}), Contains("No such file"));
  MissionOptions options;
  options.start_together = true;
  CHECK_THROWS_AS(read_missions({folder / "old.bag", folder / "cut.bag"}, options), OptionError);
}

TEST_CASE("lamp: a saved map is read from its archive and unpacked", "[io][zip]") {
  const TemporaryFolder folder;
  const std::string prefix = GENERATE("pose_graph/", "../../../");
  if (!lamp_data("lamp_zip", folder / "z", "--prefix " + prefix)) return;
  if (!ZipArchive::available()) {
    CHECK_THROWS_WITH(read_mission(folder / "z" / "saved.zip"), Contains("built without zip"));
    return;
  }
  const Json expected = expected_of(folder / "z");
  const Mission mission = read_mission(folder / "z" / "saved.zip");
  CHECK(mission.kind == MissionKind::kLampZip);
  CHECK(mission.name == "saved");
  CHECK(kinds_of(mission.problems).empty());
  check_nodes(mission, expected);  // of the last graph
  check_odometry(mission, expected);
  check_priors(mission, expected);
  check_scans(mission, expected);
  // Names inside are no paths: nothing was written.
  CHECK(std::distance(fs::directory_iterator(folder / "z"), fs::directory_iterator{}) == 2);

  const ZipArchive archive(folder / "z" / "saved.zip");
  fs::create_directories(folder / "z" / "pose_graph");
  for (std::size_t i = 0; i < archive.names().size(); ++i) {
    const std::string name = archive.names()[i];
    write_file(folder / "z" / "pose_graph" / name.substr(prefix.size()), archive.read(i));
  }
  const Mission unpacked = read_mission(folder / "z" / "pose_graph");
  CHECK(unpacked.kind == MissionKind::kLampZip);
  CHECK(unpacked.name == "z");
  check_nodes(unpacked, expected);
  check_scans(unpacked, expected);
}

TEST_CASE("lamp: damaged archives are errors", "[io][zip][error]") {
  const TemporaryFolder folder;
  if (!ZipArchive::available()) return;
  if (!lamp_data("lamp_zip", folder / "z", "--nodes 3")) return;
  const std::string whole = read_file(folder / "z" / "saved.zip");
  write_file(folder / "cut.zip", whole.substr(0, whole.size() / 2));
  CHECK_THROWS_WITH(read_mission(folder / "cut.zip"), Contains("cut.zip"));
  write_file(folder / "other.zip", whole.substr(0, 4) + "no archive");
  CHECK_THROWS_AS(read_mission(folder / "other.zip"), InputError);
  Rng rng(5);
  int errors = 0, harmless = 0;
  for (int i = 0; i < 100; ++i) {
    std::string damaged = whole;
    char& byte = damaged[rng.below(damaged.size())];
    byte = static_cast<char>(byte ^ static_cast<char>(1 + rng.below(255)));
    write_file(folder / "flip.zip", damaged);
    try {
      const Mission mission = read_mission(folder / "flip.zip");
      for (const Key key : mission.scans->keys()) static_cast<void>(mission.scans->load(key));
      ++harmless;  // a stamp or permission in the directory
    } catch (const Error&) {
      ++errors;
    }
  }
  CHECK(errors > 50);
  CHECK(errors + harmless == 100);
}

TEST_CASE("g2o_pcd: every way of naming clouds", "[io][g2o_pcd]") {
  const TemporaryFolder folder;
  struct Form {
    std::string arguments;
    bool stamps;
  };
  const Form form =
      GENERATE(values<Form>({{"--truth ground_truth/result.g2o", false},
                             {"--names letter --place . --truth gt.g2o --normals", false},
                             {"--names key --place keyed_scans --graph other.g2o", false},
                             {"--names rank --table --place clouds --truth ground_truth.g2o", true},
                             {"--names rank --place pcds", false},
                             {"--names key --place odd_name --table", true}}));
  CAPTURE(form.arguments);
  if (!lamp_data("g2o_pcd", folder / "d" / "g2o_pcd", form.arguments)) return;
  const fs::path path = folder / "d" / "g2o_pcd";
  const Json expected = expected_of(path);
  const Mission mission = read_mission(path);
  CHECK(mission.kind == MissionKind::kG2oPcd);
  CHECK(mission.name == "d");
  CHECK(names_of(mission.robots) == std::vector<std::string>{"c", "e"});
  check_nodes(mission, expected, form.stamps);
  check_odometry(mission, expected);
  testing::check_edge(mission, expected["closure"], EdgeKind::kLoopClosure);
  check_scans(mission, expected);
  if (form.arguments.find("--truth") != std::string::npos) check_truth(mission, expected);
  CHECK(mission.problems.count("no prior given") == 2);
  CHECK(mission.problems.count("no stamps given") == (form.stamps ? 0 : 1));
  CHECK(read_mission(folder / "d").graph.keys() == mission.graph.keys());
}

TEST_CASE("g2o_pcd: clouds in an archive", "[io][g2o_pcd][zip]") {
  const TemporaryFolder folder;
  if (!lamp_data("g2o_pcd", folder / "d", "--place pcd.zip")) return;
  if (!ZipArchive::available()) {
    CHECK_THROWS_WITH(read_mission(folder / "d"), Contains("built without zip"));
    return;
  }
  const Mission mission = read_mission(folder / "d");
  check_scans(mission, expected_of(folder / "d"));
  CHECK_FALSE(fs::exists(folder / "pcd"));
  CHECK_THROWS_WITH(read_mission(folder / "d" / "pcd.zip"), Contains("no pose_graph.bag"));
}

TEST_CASE("g2o_pcd: ids that lost their robots' characters", "[io][g2o_pcd]") {
  const TemporaryFolder folder;
  if (!lamp_data("g2o_pcd", folder / "one", "--robots c --ids small --truth gt.g2o")) return;
  const Json expected = expected_of(folder / "one");
  SECTION("are found by the clouds") {
    const Mission mission = read_mission(folder / "one");
    check_nodes(mission, expected, false);
    check_odometry(mission, expected);
    check_truth(mission, expected);
    check_scans(mission, expected);
  }
  SECTION("are given by an option") {
    REQUIRE(lamp_data("g2o_pcd", folder / "bare", "--robots c --ids small --names index"));
    const Mission bare = read_mission(folder / "bare");
    CHECK(bare.graph.contains(2));
    CHECK(bare.scans->has(2));
    MissionOptions options;
    options.robot_character = "c";
    const Mission mission = read_mission(folder / "bare", options);
    check_nodes(mission, expected_of(folder / "bare"), false);
    check_scans(mission, expected_of(folder / "bare"));
    options.robot_character = "7";
    CHECK_THROWS_AS(read_mission(folder / "bare", options), OptionError);
    REQUIRE(lamp_data("g2o_pcd", folder / "full", ""));
    options.robot_character = "c";
    CHECK_THROWS_WITH(read_mission(folder / "full", options), Contains("already contain robot characters"));
  }
  SECTION("and collide") {
    REQUIRE(lamp_data("g2o_pcd", folder / "two", "--ids small"));
    CHECK_THROWS_WITH(read_mission(folder / "two"),
                      Contains("result.g2o:7: vertex 0 has another pose in line 1") &&
                          Contains("lack the robots' characters") && Contains("64-bit keys"));
    // No collision, but the robot is unknown as well.
    write_file(folder / "two" / "result.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n");
    CHECK_THROWS_WITH(read_mission(folder / "two"),
                      Contains("id 0 may be c0 or e0") && Contains("64-bit keys"));
  }
}

TEST_CASE("g2o_pcd: ambiguous input is refused or counted", "[io][g2o_pcd][error]") {
  const TemporaryFolder folder;
  if (!lamp_data("g2o_pcd", folder / "d", "--names rank")) return;
  fs::remove(folder / "d" / "pcd" / "pc_3.pcd");
  CHECK_THROWS_WITH(read_mission(folder / "d"),
                    Contains("11 clouds") && Contains("12 nodes") && Contains("keys.csv"));
  const std::string c0 = std::to_string(make_key('c', 0));
  const auto table = [&](const std::string& text) { write_file(folder / "d" / "keys.csv", text); };
  table(c0 + ",pc_0.pcd\n");
  CHECK_THROWS_WITH(read_mission(folder / "d"), Contains("keys.csv:1:"));
  table(c0 + ",pc_0.pcd,5\nx,pc_1.pcd,5\n");
  CHECK_THROWS_WITH(read_mission(folder / "d"), Contains("keys.csv:2: key \"x\""));
  table(c0 + ",pc_0.pcd,5\n" + c0 + ",pc_1.pcd,5\n");
  CHECK_THROWS_WITH(read_mission(folder / "d"), Contains("keys.csv:2: node c0 appears twice"));
  table(c0 + ",pc_0.pcd,5\n1,pc_0.pcd,5\n");
  CHECK_THROWS_WITH(read_mission(folder / "d"), Contains("keys.csv:2: file \"pc_0.pcd\" appears twice"));
  table(c0 + ",pc_0.pcd,1e9\n");
  CHECK_THROWS_WITH(read_mission(folder / "d"), Contains("\"1e9\" is not a stamp in ns"));

  for (const auto& entry : fs::directory_iterator(folder / "d" / "pcd")) {
    if (entry.path().filename() != "pc_0.pcd" && entry.path().filename() != "pc_1.pcd") fs::remove(entry);
  }
  testing::write_text(folder / "d" / "pcd" / "lamp_map.pcd", "");
  table(c0 + ",pc_0.pcd,5000000000\n" + std::to_string(make_key('c', 3)) + ",pc_1.pcd,11000000000\n" +
        std::to_string(make_key('c', 99)) + ",,7\n");
  const Mission mission = read_mission(folder / "d");
  CHECK(mission.problems.count("foreign file in scans") == 1);
  CHECK(mission.problems.count("stamp without node") == 1);
  CHECK(mission.problems.count("node without stamp") == 10);
  CHECK(mission.graph.node(make_key('c', 1)).stamp_ns == 7'000'000'000);
  CHECK(mission.graph.node(make_key('c', 5)).stamp_ns == 15'000'000'000);
  CHECK(mission.graph.node(make_key('e', 1)).stamp_ns == 2'000'000'000);

  write_file(folder / "d" / "again.g2o", "");
  fs::rename(folder / "d" / "result.g2o", folder / "d" / "first.g2o");
  CHECK_THROWS_WITH(read_mission(folder / "d"),
                    Contains("again.g2o and first.g2o") && Contains("result.g2o"));
  CHECK_THROWS_WITH(mission_kind(folder.path()), Contains("rosbag/ or g2o_pcd/"));
}

TEST_CASE("joined: sessions become one mission", "[io][joined]") {
  const TemporaryFolder folder;
  if (!lamp_data("sessions", folder / "s", "--nodes 4")) return;
  const std::vector<fs::path> paths = {folder / "s" / "session0", folder / "s" / "session1",
                                       folder / "s" / "session2"};
  MissionOptions options;
  SECTION("as they stand") {
    const Mission mission = read_missions(paths, options);
    CHECK(mission.kind == MissionKind::kJoined);
    CHECK(mission.name == "session0+session1+session2");
    CHECK(names_of(mission.robots) == std::vector<std::string>{"session0", "session1", "session2"});
    REQUIRE(mission.graph.nodes().size() == 12);
    CHECK(mission.graph.node(make_key('b', 3)).pose.translation() == Eigen::Vector3d(6.0, 0.5, 0.0));
    CHECK(mission.reference.at(make_key('b', 3)).translation() == Eigen::Vector3d(6.0, 0.5, 0.0));
    CHECK(mission.graph.edges().size() == 9);
    for (const Edge& edge : mission.graph.edges()) CHECK(edge.kind == EdgeKind::kOdometry);
    CHECK(mission.graph.priors().size() == 3);
    CHECK(mission.graph.node(make_key('c', 1)).stamp_ns == 2'002'500'000'000);
    CHECK(mission.start_ns == 500'000'000);
    CHECK(mission.scans->size() == 12);
    CHECK(mission.scans->load(make_key('c', 2))->size() == 22);
    CHECK(mission.scans->load(make_key('a', 2))->size() == 20);
    CHECK(mission.problems.count("no prior given") == 0);  // each source is of one robot
    CHECK(read_missions({paths[1]}).kind == MissionKind::kSession);
  }
  SECTION("by a file of frames") {
    const Json expected = expected_of(folder / "s");
    for (const char* file : {"frames.csv", "frames.tum"}) {
      options.frames = (folder / "s" / file).string();
      options.start_together = true;
      const Mission mission = read_missions(paths, options);
      const Mission alone = read_mission(paths[2]);
      const Eigen::Isometry3d T = pose_of(expected["frames"][2]);
      for (Key i = 0; i < 4; ++i) {
        const Node& node = mission.graph.node(make_key('c', i));
        CHECK(testing::difference(node.pose, T * alone.graph.node(i).pose) < 1e-12);
        CHECK(testing::difference(mission.reference.at(node.key), T * alone.reference.at(i)) < 1e-12);
        CHECK(node.stamp_ns == 500'000'000 + static_cast<std::int64_t>(i) * 2'000'000'000);
      }
      CHECK(testing::difference(mission.graph.priors()[2].pose, T * alone.graph.priors()[0].pose) < 1e-12);
    }
  }
  SECTION("errors name what is wrong") {
    const auto with_frames = [&](const std::string& text) {
      write_file(folder / "frames", text);
      options.frames = (folder / "frames").string();
      return [&] { static_cast<void>(read_missions(paths, options)); };
    };
    const std::string head = "source,x,y,z,qx,qy,qz,qw\n";
    CHECK_THROWS_WITH(with_frames(head + "session0,0,0,0,0,0,0,1\n")(),
                      Contains("no frame of source \"session1\""));
    CHECK_THROWS_WITH(with_frames(head + "else,0,0,0,0,0,0,1\n")(),
                      Contains("frames:2:") && Contains("is not the name of a source"));
    CHECK_THROWS_WITH(with_frames("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n")(), Contains("has two frames"));
    CHECK_THROWS_WITH(with_frames("3 0 0 0 0 0 0 1\n")(), Contains("number of a source, 0 to 2"));
    CHECK_THROWS_AS(read_missions({paths[0]}, options), OptionError);
    CHECK_THROWS_AS(read_missions({}), InputError);
  }
  SECTION("with landmarks, ranges and gravity of their own") {
    const auto write = [&](const std::string& name, char character) {
      Mission one;
      one.name = name;
      one.robots = parts::with_landmarks(Robots({robot_of_character(character, "r"),
                                                 robot_of_character('C', "C"), robot_of_character('u', "u")}),
                                         {'C', 'u'});
      for (const Key key :
           {make_key(character, 5), make_key(character, 6), make_key('C', 3), make_key('u', 0)}) {
        Node node;
        node.key = key;
        node.stamp_ns = 7;
        node.pose.translation().x() = static_cast<double>(key_index(key));
        one.graph.add_node(node);
      }
      one.graph.add_edge({make_key(character, 5), make_key(character, 6), one.graph.nodes()[1].pose});
      one.graph.add_edge({make_key(character, 6), make_key('C', 3), one.graph.nodes()[2].pose});
      one.graph.add_range({make_key(character, 5), make_key('u', 0), 5.0, 0.1});
      GravityFactor gravity;
      gravity.key = make_key(character, 6);
      one.graph.add_gravity(gravity);
      MissionWriter(folder / name).finish(one);
    };
    write("one", 'k');
    write("two", 'c');
    write_file(folder / "frames", "0 0 0 0 0 0 0 1\n1 0 9 0 0 0 1 0\n");
    options.frames = (folder / "frames").string();
    const Mission mission = read_missions({folder / "one", folder / "two"}, options);
    CHECK(names_of(mission.robots) ==
          std::vector<std::string>{"one_landmarks", "two_landmarks", "one", "two"});
    CHECK(mission.robots.is_landmark(parse_key("B1")));
    // In the order of the keys that they had: C3 before u0.
    CHECK(mission.graph.node(parse_key("B0")).pose.translation().isApprox(Eigen::Vector3d(-3.0, 9.0, 0.0)));
    REQUIRE(mission.graph.edges().size() == 4);
    CHECK(mission.graph.edges()[3].to == parse_key("B0"));
    CHECK(mission.graph.edges()[3].kind == EdgeKind::kLandmark);
    REQUIRE(mission.graph.ranges().size() == 2);
    CHECK(mission.graph.ranges()[1].from == parse_key("b5"));
    CHECK(mission.graph.ranges()[1].to == parse_key("B1"));
    REQUIRE(mission.graph.gravities().size() == 2);
    CHECK(mission.graph.gravities()[1].key == parse_key("b6"));
    CHECK(mission.graph.gravities()[1].reference == -Eigen::Vector3d::UnitZ());
  }
  SECTION("stamps at both ends of time") {
    constexpr std::int64_t kFar = 4'500'000'000'000'000'000;
    const auto write = [&](const std::string& name, std::int64_t stamp_ns, std::int64_t dropped_ns) {
      Mission one;
      one.name = name;
      one.robots = Robots({robot_of_character('a', "r")});
      one.start_ns = stamp_ns;
      Node node;
      node.key = make_key('a', 0);
      node.stamp_ns = stamp_ns;
      one.graph.add_node(node);
      one.beacons = {{"b" + name, 0, node.key, dropped_ns}};
      MissionWriter(folder / name).finish(one);
    };
    write("early", -kFar, -kFar);
    write("late", kFar, kFar);
    write("backward", kFar, -kFar);
    options.start_together = true;
    const Mission mission = read_missions({folder / "early", folder / "late"}, options);
    CHECK(mission.beacons[1].stamp_ns == -kFar);
    CHECK_THROWS_WITH(read_missions({folder / "early", folder / "backward"}, options),
                      Contains("backward: a stamp of -4500000000000000000 ns is out of range"));
  }
  SECTION("of one name, and with other robots") {
    fs::create_directories(folder / "more");
    fs::copy(paths[0], folder / "more" / "session0", fs::copy_options::recursive);
    options.robots = "first=a0-a99,second=b0-b99";
    const Mission mission = read_missions({paths[0], folder / "more" / "session0"}, options);
    CHECK(mission.name == "session0+session0_2");
    CHECK(names_of(mission.robots) == std::vector<std::string>{"first", "second"});
  }
}

}  // namespace
}  // namespace loopwise::lamp_test
