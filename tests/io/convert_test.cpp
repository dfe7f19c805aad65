// SPDX-License-Identifier: BSD-3-Clause
#include <unistd.h>

#include <loopwise/io/convert.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/trajectory.hpp>

#include "cloud_testing.hpp"
#include "lamp_testing.hpp"

namespace loopwise::convert_test {
namespace {

namespace fs = std::filesystem;
using testing::lamp_data;
using testing::random_cloud;
using testing::TemporaryFolder;

/// Two robots of four nodes by ranges of plain keys, or by characters; everything that a mission may hold.
Mission make_mission(bool characters) {
  Rng rng(7);
  Mission mission;
  mission.name = "m";
  mission.robots = characters ? Robots({robot_of_character('c', "husky"), robot_of_character('e', "spot")})
                              : parse_robots("husky=10-19,spot=20-29");
  mission.start_ns = 1'600'000'000'000'000'000;
  std::vector<Key> keys;
  for (std::size_t robot = 0; robot < 2; ++robot) {
    const Key first = mission.robots[robot].first;
    for (Key i = 0; i < 4; ++i) {
      Node node;
      node.key = first + i;
      node.pose = testing::random_pose(rng, 50.0);
      node.stamp_ns = mission.start_ns + static_cast<std::int64_t>(i) * 2'000'000'001;
      mission.graph.add_node(node);
      mission.ground_truth[node.key] = testing::random_pose(rng, 50.0);
      keys.push_back(node.key);
      if (i == 0) continue;
      Matrix6d root;
      for (int k = 0; k < 36; ++k) root(k / 6, k % 6) = rng.normal();
      mission.graph.add_edge({node.key - 1, node.key, testing::random_pose(rng),
                              root * root.transpose() + 0.1 * Matrix6d::Identity(), EdgeKind::kOdometry});
    }
  }
  mission.graph.add_edge({keys[3], keys[5], testing::random_pose(rng), 7.0 * Matrix6d::Identity()});
  Matrix6d correlated = Matrix6d::Identity();
  correlated(0, 4) = correlated(4, 0) = 0.25;
  for (const Key key : {keys[0], keys[4]})
    mission.graph.add_prior({key, testing::random_pose(rng), correlated});
  mission.scans = std::make_shared<ScanStore>(keys, [](Key key) {
    if (key_index(key) % 10 == 3) throw InputError("broken scan");
    return std::make_shared<const PointCloud>(random_cloud(30, true, true, static_cast<unsigned>(key % 97)));
  });
  return mission;
}

/// The largest difference of any pose.
double pose_difference(const PoseGraph& a, const PoseGraph& b) {
  double worst = 0.0;
  for (std::size_t i = 0; i < a.nodes().size(); ++i) {
    worst = std::max(worst, testing::difference(a.nodes()[i].pose, b.nodes()[i].pose));
  }
  for (std::size_t i = 0; i < a.edges().size(); ++i) {
    worst = std::max(worst, testing::difference(a.edges()[i].T_from_to, b.edges()[i].T_from_to));
  }
  for (std::size_t i = 0; i < a.priors().size(); ++i) {
    worst = std::max(worst, testing::difference(a.priors()[i].pose, b.priors()[i].pose));
  }
  return worst;
}

/// Keys, stamps, poses and factors, in the same order.
void check_same_graph(const PoseGraph& a, const PoseGraph& b) {
  REQUIRE(a.keys() == b.keys());
  REQUIRE(a.edges().size() == b.edges().size());
  REQUIRE(a.priors().size() == b.priors().size());
  for (std::size_t i = 0; i < a.nodes().size(); ++i) CHECK(a.nodes()[i].stamp_ns == b.nodes()[i].stamp_ns);
  for (std::size_t i = 0; i < a.edges().size(); ++i) {
    CHECK(a.edges()[i].from == b.edges()[i].from);
    CHECK(a.edges()[i].to == b.edges()[i].to);
    CHECK(a.edges()[i].kind == b.edges()[i].kind);
    CHECK(a.edges()[i].information == b.edges()[i].information);  // digits that read back to the same bits
  }
  for (std::size_t i = 0; i < a.priors().size(); ++i) CHECK(a.priors()[i].key == b.priors()[i].key);
  REQUIRE(a.ranges().size() == b.ranges().size());
  for (std::size_t i = 0; i < a.ranges().size(); ++i) {
    const RangeFactor &first = a.ranges()[i], &second = b.ranges()[i];
    CHECK((first.from == second.from && first.to == second.to));
    CHECK((first.range_m == second.range_m && first.sigma_m == second.sigma_m));
  }
  REQUIRE(a.gravities().size() == b.gravities().size());
  for (std::size_t i = 0; i < a.gravities().size(); ++i) {
    CHECK(a.gravities()[i].key == b.gravities()[i].key);
    CHECK(a.gravities()[i].sigma_rad == b.gravities()[i].sigma_rad);
    // Made of unit length anew each time.
    CHECK((a.gravities()[i].direction - b.gravities()[i].direction).norm() < 1e-15);
  }
  // Through a quaternion and back: measured 4e-16 of rotations, exactly 0 of positions.
  CHECK(pose_difference(a, b) < 1e-14);
}

void check_same_scans(const Mission& a, const Mission& b) {
  REQUIRE(a.scans->keys() == b.scans->keys());
  for (const Key key : a.scans->keys()) {
    const auto first = a.scans->load(key), second = b.scans->load(key);
    CHECK(first->points == second->points);
    CHECK(first->intensities == second->intensities);
    REQUIRE(first->normals.size() == second->normals.size());
    for (std::size_t i = 0; i < first->normals.size(); ++i) {
      // Made of unit length anew each time.
      REQUIRE((first->normals[i] - second->normals[i]).cwiseAbs().maxCoeff() < 1e-6f);
    }
  }
}

TEST_CASE("convert: a bag to a mission, to g2o_pcd, and back", "[io][convert][bag]") {
  const TemporaryFolder folder;
  const std::string form = GENERATE("bags", "base", "factors");
  CAPTURE(form);
  if (!lamp_data(form, folder / "bags", "--compression lz4 --nodes 8")) return;
  const std::size_t scans = form == "factors" ? 9 : 16, names = form == "bags" ? 2 : form == "base" ? 3 : 0;
  const Mission bag = read_mission(form == "bags" ? folder / "bags" / "rosbag" : folder / "bags");
  ConvertOptions options;
  options.threads = 3;
  const ConvertResult first = convert_mission(bag, folder / "mission", MissionFormat::kMission, options);
  CHECK(first.scans == scans);
  CHECK(first.left_out.empty());
  const Mission mission = read_mission(folder / "mission");
  CHECK(mission.problems.empty());
  const ConvertResult second = convert_mission(mission, folder / "g2o_pcd", MissionFormat::kG2oPcd, options);
  CHECK(second.scans == scans);
  CHECK(second.left_out.count("robot name left out") == names);
  CHECK(second.left_out.count("provenance left out") == 1);
  CHECK(second.left_out.count("radio reading left out") == mission.radio.size());
  CHECK(second.left_out.count("beacon left out") == mission.beacons.size());
  const Mission pcd = read_mission(folder / "g2o_pcd");
  CHECK(pcd.kind == MissionKind::kG2oPcd);
  CHECK(pcd.problems.empty());
  const ConvertResult third = convert_mission(pcd, folder / "again", MissionFormat::kMission, options);
  CHECK(third.scans == scans);
  const Mission again = read_mission(folder / "again");

  check_same_graph(bag.graph, mission.graph);
  check_same_graph(mission.graph, pcd.graph);
  check_same_graph(pcd.graph, again.graph);
  for (std::size_t i = 0; i < bag.graph.priors().size(); ++i) {
    // priors.csv holds sigmas where there are no correlations: measured relative difference 3e-16.
    CHECK(again.graph.priors()[i].information.isApprox(bag.graph.priors()[i].information, 1e-13));
  }
  for (const Mission* other : {&mission, &pcd, &again}) {
    check_same_scans(bag, *other);
    CHECK(other->start_ns == bag.start_ns);
    REQUIRE(other->ground_truth.size() == bag.ground_truth.size());
    for (const auto& [key, pose] : bag.ground_truth) {
      CHECK(testing::difference(other->ground_truth.at(key), pose) < 1e-14);
    }
  }
  for (const Node& node : bag.graph.nodes()) {
    for (const Mission* other : {&mission, &pcd, &again}) {
      CHECK(other->robots.is_landmark(node.key) == bag.robots.is_landmark(node.key));
    }
  }
  if (form == "factors") testing::check_optimum(again, testing::expected_of(folder / "bags"));
  CHECK(mission.robots[0].name == bag.robots[0].name);
  CHECK(mission.radio.size() == bag.radio.size());
  CHECK(mission.provenance_json == bag.provenance_json);
}

TEST_CASE("convert: g2o_pcd holds stamps, priors and truth, and lists its losses", "[io][convert]") {
  const TemporaryFolder folder;
  Mission mission = make_mission(true);
  mission.start_ns -= 5;
  mission.frame = "tunnel";
  mission.gaps = {{1, 0.0, 3.0}};
  mission.reference = mission.ground_truth;
  const ConvertResult result = convert_mission(mission, folder / "g", MissionFormat::kG2oPcd);
  CHECK(result.left_out.count("reference pose left out") == 8);
  CHECK(result.scans == 6);  // two are broken
  CHECK(mission.scans->problems().count("scan is damaged") == 2);
  for (const char* kind :
       {"name of the frame left out", "communication gap left out", "clock's start left out"}) {
    CHECK(result.left_out.count(kind) == 1);
  }
  const Mission back = read_mission(folder / "g");
  check_same_graph(mission.graph, back.graph);
  for (std::size_t i = 0; i < 2; ++i) {
    CHECK(back.graph.priors()[i].information == mission.graph.priors()[i].information);
  }
  CHECK(back.problems.count("node without scan") == 2);
  CHECK(back.problems.all().size() == 1);
  CHECK(back.ground_truth.size() == 8);
  CHECK(back.reference.empty());
  CHECK(read_file(folder / "g" / "keys.csv").substr(0, 20) == std::to_string(make_key('c', 0)) + ",");
}

TEST_CASE("convert: robots that a list distinguishes get a letter each", "[io][convert]") {
  const TemporaryFolder folder;
  const Mission mission = make_mission(false);
  const ConvertResult result = convert_mission(mission, folder / "g", MissionFormat::kG2oPcd);
  CHECK(result.left_out.count("key renamed") == 8);
  const Mission back = read_mission(folder / "g");
  REQUIRE(back.graph.nodes().size() == 8);
  for (std::size_t i = 0; i < 8; ++i) {
    const Key key = make_key(i < 4 ? 'a' : 'b', i % 4);
    CHECK(back.graph.nodes()[i].key == key);
    CHECK(testing::difference(back.graph.nodes()[i].pose, mission.graph.nodes()[i].pose) < 1e-14);
    CHECK(back.graph.nodes()[i].stamp_ns == mission.graph.nodes()[i].stamp_ns);
    CHECK(back.ground_truth.count(key) == 1);
  }
  for (std::size_t e = 0; e < mission.graph.edges().size(); ++e) {
    CHECK(back.graph.edges()[e].kind == mission.graph.edges()[e].kind);
  }
  CHECK(back.scans->load(make_key('b', 1))->size() == 30);
}

TEST_CASE("convert: landmarks get capital letters, and are in no trajectory", "[io][convert]") {
  const TemporaryFolder folder;
  Mission mission = make_mission(false);
  std::vector<Robot> robots = mission.robots.all();
  robots.push_back({"signs", 90, 99, true});
  mission.robots = Robots(std::move(robots));
  Node sign;
  sign.key = 93;
  sign.stamp_ns = mission.start_ns + 3;
  mission.graph.add_node(sign);
  mission.graph.add_edge({12, 93, Eigen::Isometry3d::Identity(), Matrix6d::Identity(), EdgeKind::kLandmark});
  mission.graph.add_range({21, 93, 4.5, 0.1});
  GravityFactor gravity;
  gravity.key = 22;
  mission.graph.add_gravity(gravity);
  const ConvertResult result = convert_mission(mission, folder / "g", MissionFormat::kG2oPcd);
  CHECK(result.left_out.count("key renamed") == 9);
  const Mission back = read_mission(folder / "g");
  CHECK(testing::names_of(back.robots) == std::vector<std::string>{"a_artifacts", "a", "b"});
  CHECK(back.robots.is_landmark(make_key('A', 3)));
  CHECK(back.graph.node(make_key('A', 3)).stamp_ns == sign.stamp_ns);
  CHECK(back.graph.edges().back().kind == EdgeKind::kLandmark);
  REQUIRE(back.graph.ranges().size() == 1);
  CHECK(back.graph.ranges()[0].to == make_key('A', 3));
  REQUIRE(back.graph.gravities().size() == 1);
  CHECK(back.graph.gravities()[0].key == make_key('b', 2));
  CHECK(back.problems.count("no prior given") == 0);

  const ConvertResult tum = convert_mission(mission, folder / "tum", MissionFormat::kTum);
  for (const char* kind : {"landmark left out", "range left out", "gravity left out"}) {
    CHECK(tum.left_out.count(kind) == 1);
  }
  CHECK(tum.left_out.count("key left out") == 8);
  CHECK_FALSE(fs::exists(folder / "tum" / "signs.tum"));

  // Without stamps, a landmark is first seen when a node first sees it.
  fs::remove(folder / "g" / "keys.csv");
  const Mission bare = read_mission(folder / "g");
  CHECK(bare.graph.node(make_key('A', 3)).stamp_ns == 2'000'000'000);
}

TEST_CASE("convert: trajectories", "[io][convert]") {
  const TemporaryFolder folder;
  Mission mission = make_mission(true);
  mission.robots = Robots({robot_of_character('c', "../husky"), robot_of_character('e', "a/_husky")});
  mission.reference[make_key('c', 1)] = mission.ground_truth.at(make_key('c', 1));
  const ConvertResult tum = convert_mission(mission, folder / "tum", MissionFormat::kTum);
  CHECK(tum.left_out.count("edge left out") == 7);
  CHECK(tum.left_out.count("prior left out") == 2);
  CHECK(tum.left_out.count("scan left out") == 8);
  const std::vector<StampedPose> poses = read_tum(folder / "tum" / "___husky.tum");
  REQUIRE(poses.size() == 4);
  for (std::size_t i = 0; i < 4; ++i) {
    CHECK(poses[i].stamp_ns == mission.graph.nodes()[i].stamp_ns);
    CHECK(testing::difference(poses[i].pose, mission.graph.nodes()[i].pose) < 1e-14);
  }
  CHECK(read_tum(folder / "tum" / "a__husky_truth.tum").size() == 4);
  CHECK(read_tum(folder / "tum" / "___husky_reference.tum").size() == 1);
  CHECK_FALSE(fs::exists(folder / "tum" / "a__husky_reference.tum"));

  mission.ground_truth.erase(make_key('e', 1));
  fs::create_directories(folder / "kitti");  // an empty folder will do
  const ConvertResult kitti = convert_mission(mission, folder / "kitti", MissionFormat::kKitti);
  CHECK(kitti.left_out.count("stamp left out") == 8);
  CHECK(kitti.left_out.count("incomplete ground truth left out") == 3);
  CHECK(kitti.left_out.count("incomplete reference left out") == 1);
  CHECK_FALSE(fs::exists(folder / "kitti" / "___husky_reference.kitti"));
  CHECK(read_kitti(folder / "kitti" / "___husky.kitti").size() == 4);
  CHECK(read_kitti(folder / "kitti" / "___husky_truth.kitti").size() == 4);
  CHECK_FALSE(fs::exists(folder / "kitti" / "a__husky_truth.kitti"));
  std::size_t entries = 0;
  for (const auto& entry : fs::directory_iterator(folder.path())) entries += entry.exists() ? 1 : 0;
  CHECK(entries == 2);  // nothing is left beside the targets

  // Robots whose names make one file's name.
  mission.robots = Robots({robot_of_character('c', "a b"), robot_of_character('e', "a_b")});
  static_cast<void>(convert_mission(mission, folder / "same", MissionFormat::kTum));
  CHECK(fs::exists(folder / "same" / "a_b.tum"));
  CHECK(fs::exists(folder / "same" / "a_b_2.tum"));
  // One whose name is that of another's truth.
  mission.robots = Robots({robot_of_character('c', "a"), robot_of_character('e', "a_truth")});
  static_cast<void>(convert_mission(mission, folder / "truth", MissionFormat::kTum));
  CHECK(read_tum(folder / "truth" / "a_truth.tum").size() == 4);
  CHECK(read_tum(folder / "truth" / "a_truth_2.tum").size() == 4);

  // What a killed conversion left is not taken along, though another process may have its number.
  const fs::path left = folder / (".next." + std::to_string(::getpid()) + "-0.tmp");
  fs::create_directories(left);
  testing::write_text(left / "of_another.tum", "");
  static_cast<void>(convert_mission(mission, folder / "next", MissionFormat::kTum));
  CHECK_FALSE(fs::exists(folder / "next" / "of_another.tum"));
}

TEST_CASE("convert: a target is complete or absent", "[io][convert][error]") {
  const TemporaryFolder folder;
  const Mission mission = make_mission(true);
  const MissionFormat format = GENERATE(MissionFormat::kMission, MissionFormat::kG2oPcd, MissionFormat::kTum);
  CAPTURE(enum_name(format));
  fs::create_directories(folder / "full");
  testing::write_text(folder / "full" / "mine", "");
  testing::write_text(folder / "file", "");
  CHECK_THROWS_WITH(convert_mission(mission, folder / "full", format), Contains("is not empty"));
  CHECK_THROWS_WITH(convert_mission(mission, folder / "file", format), Contains("is not a folder"));
  CHECK_THROWS_AS(convert_mission(mission, folder / "file" / "deeper", format), IoError);
  CHECK(fs::exists(folder / "full" / "mine"));

  if (format == MissionFormat::kTum) return;
  const StopSource stop;
  ConvertOptions options;
  options.stop = stop.token();
  std::size_t calls = 0;
  options.progress = [&](const Progress& p) {
    CHECK(p.total == 8);
    if (++calls == 3) stop.request_stop();
  };
  fs::create_directories(folder / "empty");
  CHECK_THROWS_AS(convert_mission(mission, folder / "new", format, options), StoppedError);
  CHECK_FALSE(fs::exists(folder / "new"));
  CHECK_THROWS_AS(convert_mission(mission, folder / "empty", format, options), StoppedError);
  CHECK(fs::is_empty(folder / "empty"));
  CHECK(calls == 3);

  // A killed conversion leaves all files except the last one.
  static_cast<void>(convert_mission(mission, folder / "killed", format));
  if (format == MissionFormat::kMission) {
    fs::remove(folder / "killed" / "mission.json");
    testing::write_text(folder / "killed" / ".unfinished", "");
    CHECK_THROWS_WITH(read_mission(folder / "killed"), Contains("incomplete mission"));
  } else {
    fs::remove(folder / "killed" / "result.g2o");
    CHECK_THROWS_WITH(read_mission(folder / "killed"), Contains("written last"));
  }
}

}  // namespace
}  // namespace loopwise::convert_test
