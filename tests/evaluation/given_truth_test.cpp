// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::given_truth_test {
namespace {

using testing::TemporaryFolder;

/// Two circles with a reference but without ground truth.
Mission without_truth() {
  Mission mission = testing::two_circles();
  mission.reference = std::exchange(mission.ground_truth, {});
  return mission;
}

/// One robot's true poses by stamp, all of them later by a shift.
std::vector<StampedPose> true_path(char robot, std::int64_t shift_ns = 0) {
  const Mission mission = testing::two_circles();
  std::vector<StampedPose> path;
  for (const auto& [key, pose] : mission.ground_truth) {
    if (key_character(key) == robot) path.push_back({mission.graph.node(key).stamp_ns + shift_ns, pose});
  }
  return path;
}

void check_is_true(const Mission& mission, double tolerance) {
  const Mission right = testing::two_circles();
  for (const auto& [key, pose] : mission.ground_truth) {
    CAPTURE(key_name(key));
    REQUIRE(testing::difference(pose, right.ground_truth.at(key)) < tolerance);
  }
}

void write_truth_g2o(const testing::fs::path& file, const Eigen::Isometry3d& T) {
  PoseGraph graph;
  for (const auto& [key, pose] : testing::two_circles().ground_truth) {
    Node node;
    node.key = key;
    node.pose = T * pose;
    graph.add_node(node);
  }
  write_g2o(file, graph);
}

}  // namespace

TEST_CASE("given truth: by key, by stamp of each robot, by row", "[evaluation][truth]") {
  const TemporaryFolder folder;
  write_truth_g2o(folder / "all.g2o", Eigen::Isometry3d::Identity());
  Mission mission = without_truth();
  set_truth(mission, {(folder / "all.g2o").string()});
  CHECK(mission.ground_truth.size() == 80);
  CHECK_FALSE(mission.truth_is_aligned);
  CHECK(mission.truth_file == (folder / "all.g2o").string());
  CHECK(mission.problems.empty());
  CHECK(mission.reference.size() == 80);
  check_is_true(mission, 1e-12);

  // A name may hold '='.
  write_tum(folder / "x=a.tum", true_path('a'));
  write_tum(folder / "b.tum", true_path('b'));
  mission = without_truth();
  set_truth(mission, {"b=" + (folder / "b.tum").string()});
  CHECK(mission.ground_truth.size() == 40);
  CHECK(mission.problems.count("node without ground truth") == 40);
  set_truth(mission, {"a=" + (folder / "x=a.tum").string(), "b=" + (folder / "b.tum").string()});
  CHECK(mission.ground_truth.size() == 80);
  check_is_true(mission, 1e-12);

  std::vector<Eigen::Isometry3d> rows;
  for (const StampedPose& pose : true_path('a')) rows.push_back(pose.pose);
  write_kitti(folder / "a.kitti", rows);
  mission = without_truth();
  set_truth(mission, {"a=" + (folder / "a.kitti").string()});
  CHECK(mission.ground_truth.size() == 40);
  check_is_true(mission, 1e-12);
}

TEST_CASE("given truth: stamps in between are interpolated, far ones are not", "[evaluation][truth]") {
  const TemporaryFolder folder;
  // Four poses a step, none at a node's stamp: chords of 0.5 m on a circle of 20 m are 1.6 mm off.
  std::vector<StampedPose> path;
  Eigen::Isometry3d quarter = Eigen::Isometry3d::Identity();
  quarter.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 0.025));
  quarter.translation() = Eigen::Vector3d(0.5, 0.00625, 0.0);
  for (const StampedPose& at : true_path('a')) {
    Eigen::Isometry3d back = Eigen::Isometry3d::Identity();
    back.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, -0.0125));
    back.translation() = Eigen::Vector3d(-0.25, 0.0015625, 0.0);
    Eigen::Isometry3d pose = at.pose * back;
    for (int i = 0; i < 4; ++i, pose = pose * quarter)
      path.push_back({at.stamp_ns - 250'000'000 + 500'000'000 * i, pose});
  }
  std::reverse(path.begin(), path.end());  // the order of the file says nothing
  write_tum(folder / "dense.tum", path);
  Mission mission = without_truth();
  set_truth(mission, {"a=" + (folder / "dense.tum").string()});
  CHECK(mission.ground_truth.size() == 40);
  check_is_true(mission, 0.01);  // measured 0.0031; the next pose of the file is 0.25 m off

  // Gaps of 2 s are not interpolated, unless one says so.
  write_tum(folder / "late.tum", true_path('a', 300'000'000));
  mission = without_truth();
  CHECK_THROWS_WITH(set_truth(mission, {"a=" + (folder / "late.tum").string()}),
                    Contains("late.tum: no stamp near that of a node"));
  MissionOptions options;
  options.truth_max_time_difference_s = 2.0;
  set_truth(mission, {"a=" + (folder / "late.tum").string()}, options);
  CHECK(mission.ground_truth.size() == 39);  // the first node is before all
  write_tum(folder / "close.tum", true_path('a', 15'000'000));
  mission = without_truth();
  set_truth(mission, {"a=" + (folder / "close.tum").string()});
  CHECK(mission.ground_truth.size() == 40);
  check_is_true(mission, 1e-12);
}

TEST_CASE("given truth: another frame does not change errors", "[evaluation][truth]") {
  const TemporaryFolder folder;
  Rng rng(3);
  Eigen::Isometry3d T = testing::random_pose(rng, 1.0);
  T.translation() = Eigen::Vector3d(460000.0, 5.4e6, 300.0);  // a map's grid
  write_truth_g2o(folder / "grid.g2o", T);
  Mission mission = without_truth();
  set_truth(mission, {(folder / "grid.g2o").string()});
  CHECK(mission.truth_is_aligned);
  CHECK(mission.problems.count("truth in another frame") == 1);
  CHECK(mission.ground_truth.size() == 80);

  const Mission right = testing::two_circles();
  ReplayResult result;
  result.graph = mission.graph;
  result.odometry = mission.graph.poses();
  const RunEvaluation here = evaluate_run(mission, result), there = evaluate_run(right, result);
  CHECK(here.optimized.alignment == Alignment::kSe3);
  CHECK(here.optimized.ate_m.mean == Approx(there.optimized_aligned.ate_m.mean).epsilon(1e-5));
  CHECK(here.optimized_aligned.ate_m.mean == Approx(there.optimized_aligned.ate_m.mean).epsilon(1e-5));
  CHECK(odometry_drift(mission)[0].end_m == Approx(odometry_drift(right)[0].end_m).epsilon(1e-4));
  const Json summary = parse_json(run_summary_json(mission, ReplayOptions(), result, here), "summary");
  CHECK(summary.at("truth").at("alignment") == "se3");
  CHECK(summary.at("truth").at("file") == (folder / "grid.g2o").string());

  // Rotated about the start: the first nodes alone would not show it.
  T = Eigen::Isometry3d(Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitZ()));
  write_truth_g2o(folder / "turned.g2o", T);
  mission = without_truth();
  set_truth(mission, {(folder / "turned.g2o").string()});
  CHECK(mission.truth_is_aligned);
}

TEST_CASE("given truth: a rotation of a few degrees is another frame, noise is not", "[evaluation][truth]") {
  const TemporaryFolder folder;
  const auto is_aligned = [&](const Eigen::Isometry3d& T) {
    write_truth_g2o(folder / "t.g2o", T);
    Mission mission = without_truth();
    set_truth(mission, {(folder / "t.g2o").string()});
    return mission.truth_is_aligned;
  };
  CHECK_FALSE(is_aligned(Eigen::Isometry3d::Identity()));
  // Within half a metre and a tenth of the path everywhere.
  for (const double degrees : {-8.0, -4.0, 4.0, 8.0}) {
    CAPTURE(degrees);
    CHECK(is_aligned(Eigen::Isometry3d(Eigen::AngleAxisd(degrees * 0.0174533, Eigen::Vector3d::UnitZ()))));
  }

  // Orientations that are 1.5 degrees off in every pose, at random.
  PoseGraph noisy;
  Rng rng(5);
  for (const auto& [key, pose] : testing::two_circles().ground_truth) {
    Node node;
    node.key = key;
    node.pose = pose;
    const Eigen::Vector3d off(rng.normal(0.0, 1.0), rng.normal(0.0, 1.0), rng.normal(0.0, 1.0));
    node.pose.linear() *= se3::so3_exp(0.026 * off.normalized());
    noisy.add_node(node);
  }
  write_g2o(folder / "noisy.g2o", noisy);
  Mission mission = without_truth();
  set_truth(mission, {(folder / "noisy.g2o").string()});
  CHECK_FALSE(mission.truth_is_aligned);
}

TEST_CASE("given truth: a late beginning is reported", "[evaluation][truth]") {
  const TemporaryFolder folder;
  const auto late = [&](char robot, std::size_t skipped) {
    std::vector<StampedPose> path = true_path(robot);
    path.erase(path.begin(), path.begin() + static_cast<std::ptrdiff_t>(skipped));
    const std::string file = (folder / (std::string(1, robot) + ".tum")).string();
    write_tum(file, path);
    return std::string(1, robot) + "=" + file;
  };
  // The odometry has drifted by the time that the truth begins: the frame is that of the other robot's truth.
  Mission mission = without_truth();
  set_truth(mission, {late('a', 0), late('b', 15)});
  CHECK_FALSE(mission.truth_is_aligned);
  CHECK(mission.problems.count("truth begins late") == 1);
  CHECK_THAT(
      mission.problems.all().front().example,
      Contains("robot b: no true pose within the first 10 m, assumed to be in the frame of the others"));
  // Alone it does not determine the frame.
  mission = without_truth();
  set_truth(mission, {late('b', 15)});
  CHECK(mission.truth_is_aligned);
  CHECK(mission.problems.count("truth begins late") == 1);
  CHECK(mission.problems.count("truth in another frame") == 1);
  // The path begins at the robot's first node, known or not.
  mission = without_truth();
  set_truth(mission, {late('b', 3)});
  CHECK_FALSE(mission.truth_is_aligned);
  CHECK(mission.problems.count("truth begins late") == 0);
}

TEST_CASE("given truth: invented or moved stamps pair with nothing", "[evaluation][truth][error]") {
  const TemporaryFolder folder;
  write_tum(folder / "a.tum", true_path('a'));
  std::vector<Eigen::Isometry3d> rows;
  for (const StampedPose& pose : true_path('a')) rows.push_back(pose.pose);
  write_kitti(folder / "a.kitti", rows);
  const std::string by_stamp = "a=" + (folder / "a.tum").string(),
                    by_row = "a=" + (folder / "a.kitti").string();
  // As readers put it where they take a node every 2 s.
  for (const char* kind : {"no stamps given", "node without stamp"}) {
    CAPTURE(kind);
    Mission mission = without_truth();
    mission.problems.add(kind, "session/times.txt");
    CHECK_THROWS_WITH(set_truth(mission, {by_stamp}),
                      Contains("a.tum: pairs by stamp") && Contains("are invented") &&
                          Contains("session/times.txt") && Contains("give a g2o file"));
    CHECK(mission.ground_truth.empty());
    set_truth(mission, {by_row});
    CHECK(mission.ground_truth.size() == 40);
  }
  Mission mission = without_truth();
  mission.kind = MissionKind::kJoined;
  MissionOptions options;
  options.start_together = true;
  CHECK_THROWS_WITH(set_truth(mission, {by_stamp}, options), Contains("moved (--start-together)"));
  options.start_together = false;
  set_truth(mission, {by_stamp}, options);
  CHECK(mission.ground_truth.size() == 40);
}

TEST_CASE("given truth: strict reading covers its files", "[evaluation][truth][error]") {
  const TemporaryFolder folder;
  std::string text;
  for (const StampedPose& at : true_path('a')) {
    const Eigen::Vector3d p = at.pose.translation();
    const Eigen::Quaterniond q(at.pose.linear());
    text += std::to_string(at.stamp_ns / 1'000'000'000) + ".0 " + std::to_string(p.x()) + " " +
            std::to_string(p.y()) + " " + std::to_string(p.z()) + " " + std::to_string(1.02 * q.x()) + " " +
            std::to_string(1.02 * q.y()) + " " + std::to_string(1.02 * q.z()) + " " +
            std::to_string(1.02 * q.w()) + "\n";
  }
  testing::write_text(folder / "a.tum", text);
  const std::vector<std::string> files{"a=" + (folder / "a.tum").string()};
  Mission mission = without_truth();
  set_truth(mission, files);
  CHECK(mission.problems.count("non-unit quaternion") == 40);
  mission = without_truth();
  MissionOptions options;
  options.strict = true;
  CHECK_THROWS_WITH(set_truth(mission, files, options), Contains("non-unit quaternion"));
}

TEST_CASE("given truth: a file that cannot belong to the nodes is refused with a remedy",
          "[evaluation][truth][error]") {
  const TemporaryFolder folder;
  Mission mission = without_truth();
  const auto refused = [&](const std::string& file, const std::string& why) {
    CAPTURE(file);
    CHECK_THROWS_WITH(set_truth(mission, {file}), Contains(why));
    CHECK(mission.ground_truth.empty());
  };
  std::vector<StampedPose> a = true_path('a');
  write_tum(folder / "a.tum", a);
  refused((folder / "a.tum").string(), "the mission has the robots a, b: give ROBOT=FILE for each");
  refused("c=" + (folder / "a.tum").string(), "no robot is called \"c\", the robots are a, b");
  CHECK_THROWS_WITH(
      set_truth(mission, {"a=" + (folder / "a.tum").string(), "a=" + (folder / "a.tum").string()}),
      Contains("node a0 has a true pose already"));
  write_kitti(folder / "short.kitti", {a[0].pose, a[1].pose});
  refused("a=" + (folder / "short.kitti").string(), "2 rows for 40 nodes");
  refused((folder / "absent.tum").string(), "absent.tum");
  PoseGraph other;
  Node node;
  node.key = make_key('z', 3);
  other.add_node(node);
  write_g2o(folder / "other.g2o", other);
  refused((folder / "other.g2o").string(), "none of its 1 keys is that of a node");

  // Of GPS, which knows no orientations, and of a camera that looks ahead.
  std::vector<StampedPose> positions = a, camera = a;
  const Eigen::Matrix3d looks = (Eigen::Matrix3d() << 0, 0, 1, -1, 0, 0, 0, -1, 0).finished();
  for (StampedPose& pose : positions) pose.pose.linear() = Eigen::Matrix3d::Identity();
  for (StampedPose& pose : camera) pose.pose.linear() *= looks;
  write_tum(folder / "positions.tum", positions);
  write_tum(folder / "camera.tum", camera);
  for (const char* name : {"positions.tum", "camera.tum"})
    refused("a=" + (folder / name).string(), "its orientations are not those of the nodes");
}

}  // namespace loopwise::given_truth_test
