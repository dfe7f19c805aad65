// SPDX-License-Identifier: BSD-3-Clause
#include "mission_seeds.hpp"

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

namespace loopwise::fuzz {
namespace {

namespace fs = std::filesystem;

Eigen::Isometry3d at(double x, double yaw) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = Eigen::Vector3d(x, 0.5, 0.0);
  return T;
}

PointCloud small_cloud() {
  PointCloud cloud;
  for (int i = 0; i < 3; ++i) {
    cloud.points.emplace_back(static_cast<float>(i), 1.0f, -2.0f);
    cloud.intensities.push_back(static_cast<float>(i));
  }
  return cloud;
}

/// Two robots with two nodes each and one of everything.
Mission small_mission() {
  Mission mission;
  mission.name = "seed";
  mission.robots =
      Robots({{"husky", make_key('a', 0), make_key('a', 9)}, {"spot", make_key('b', 0), make_key('b', 9)}});
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < 2; ++i) {
      Node node;
      node.key = make_key(robot, i);
      node.stamp_ns = static_cast<std::int64_t>(1'600'000'000'000'000'000 + i * 2'000'000'000);
      node.pose = at(static_cast<double>(i) + (robot == 'b' ? 5.0 : 0.0), 0.1 * static_cast<double>(i));
      mission.graph.add_node(node);
      mission.ground_truth.emplace(node.key, node.pose);
    }
    const Key first = make_key(robot, 0);
    mission.graph.add_edge({first, first + 1, at(1.0, 0.1), 100.0 * Matrix6d::Identity()});
    mission.graph.add_prior({first, mission.graph.node(first).pose, 1e4 * Matrix6d::Identity()});
  }
  classify_edges(mission.graph, mission.robots);
  mission.graph.add_range({make_key('a', 1), make_key('b', 1), 5.0, 0.1});
  GravityFactor gravity;
  gravity.key = make_key('a', 0);
  gravity.direction = -Eigen::Vector3d::UnitZ();
  gravity.sigma_rad = 0.01;
  mission.graph.add_gravity(gravity);
  mission.start_ns = 1'600'000'000'000'000'000;
  mission.gaps.push_back({0, 1.0, 2.0});
  mission.radio.push_back({make_key('a', 0), "beacon1", 20.0, "0", -60.0});
  mission.beacons.push_back({"beacon1", 0, make_key('a', 0), 1'600'000'000'000'000'000});
  mission.provenance_json = R"({"made": "by hand"})";
  mission.scans = std::make_shared<ScanStore>(mission.graph.keys(), ScanLoader([](Key) {
                                                return std::make_shared<const PointCloud>(small_cloud());
                                              }));
  return mission;
}

void write_session(const fs::path& folder) {
  fs::create_directories(folder / "Scans");
  const std::vector<Eigen::Isometry3d> poses = {at(0.0, 0.0), at(1.0, 0.1), at(2.0, 0.2)};
  write_kitti(folder / "optimized_poses.txt", poses);
  write_kitti(folder / "odom_poses.txt", poses);
  write_file(folder / "times.txt", "1600000000.5\n1600000001.5\n1.6000000025e9\n");
  write_pcd(folder / "Scans" / "000000.pcd", small_cloud());
  PoseGraph graph;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    Node node;
    node.key = i;
    node.pose = poses[i];
    graph.add_node(node);
    if (i > 0) graph.add_edge({i - 1, i, at(1.0, 0.1), Matrix6d::Identity()});
  }
  write_g2o(folder / "singlesession_posegraph.g2o", graph);
}

}  // namespace

void write_seed_missions(const fs::path& folder) {
  std::error_code ignored;
  fs::remove_all(folder, ignored);
  fs::create_directories(folder);
  const Mission mission = small_mission();
  write_mission(folder / "mission", mission);
  static_cast<void>(convert_mission(mission, folder / "g2o_pcd", MissionFormat::kG2oPcd));
  write_session(folder / "session");
  write_session(folder / "session2");
  write_session(folder / "graph_session");  // odometry from its graph
  fs::remove(folder / "graph_session" / "odom_poses.txt");
  CsvText frames({"source", "x", "y", "z", "qx", "qy", "qz", "qw"});
  frames.row("session", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0);
  frames.row("session2", 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0);
  write_file(folder / "session" / "frames.csv", frames.text());
  write_seed_saved_maps(folder);
}

const SeedFiles& seed_mission_files() {
  static const std::string first = std::to_string(make_key('a', 0));
  static const SeedFiles files = {{"mission", "mission.json"},
                                  {"mission", "graph.g2o"},
                                  {"mission", "stamps.csv"},
                                  {"mission", "priors.csv"},
                                  {"mission", "radio.csv"},
                                  {"mission", "beacons.csv"},
                                  {"mission", "ranges.csv"},
                                  {"mission", "gravity.csv"},
                                  {"mission", "ground_truth.g2o"},
                                  {"mission", "scans/" + first + ".pcd"},
                                  {"session", "optimized_poses.txt"},
                                  {"session", "odom_poses.txt"},
                                  {"session", "times.txt"},
                                  {"graph_session", "singlesession_posegraph.g2o"},
                                  {"session", "frames.csv"},
                                  {"g2o_pcd", "result.g2o"},
                                  {"g2o_pcd", "keys.csv"},
                                  {"g2o_pcd", "pcd/" + first + ".pcd"},
                                  {"kitti", "poses.txt"},
                                  {"kitti", "times.txt"},
                                  {"kitti", "calib.txt"},
                                  {"stamped", "poses.txt"},
                                  {"glim", "graph.txt"},
                                  {"glim", "000000/data.txt"},
                                  {"fast_lio", "poses_tum.txt"},
                                  {"hba", "pose.json"},
                                  {"voxel", "alidarState.txt"},
                                  {"kiss", "local_map_graph.g2o"},
                                  {"kiss", "plys/000000.ply"},
                                  {"mrg", "g2o/graph.g2o"},
                                  {"mrg", "keyframes/000000.txt"},
                                  {"open3d", "graph.json"}};
  return files;
}

void write_seed_runs(const fs::path& folder) {
  const fs::path run = folder / "run", study = folder / "study";
  fs::create_directories(run / "trajectories");
  fs::create_directories(study / "units");
  const Mission mission = small_mission();
  write_g2o(run / "graph.g2o", mission.graph);
  for (const char robot : {'a', 'b'}) {
    std::vector<StampedPose> poses;
    for (const Node& node : mission.graph.nodes()) {
      if (key_character(node.key) == robot) poses.push_back({node.stamp_ns, node.pose});
    }
    const std::string name = robot == 'a' ? "husky" : "spot";
    write_tum(run / "trajectories" / (name + ".tum"), poses);
    write_tum(run / "trajectories" / (name + "_odometry.tum"), poses);
  }
  CsvText closures({"from", "to", "source", "outcome", "weight", "mission_time_s"});
  closures.row(make_key('b', 1), make_key('a', 0), "proximity", "verified", "1", "3.5");
  closures.row(make_key('b', 0), make_key('a', 1), "proximity", "rejected", "nan", "4");
  write_file(run / "closures.csv", closures.text());
  CsvText history({"mission_time_s", "queued", "computed", "verified", "ate_m"});
  for (const double time_s : {1.0, 2.0}) history.row(time_s, 5, 4, 3, 0.5);
  write_file(run / "history.csv", history.text());
  write_pcd(run / "map.pcd", small_cloud());
  const std::string replay =
      R"("replay": {"registration_time_s": 1.0, "workers": 1, "after_mission": false})";
  const std::string summary = R"({"mission": "seed", "method": "full", "seed": 1, "mission_end_s": 10.0,
 "ate_m": {"optimized": 0.5}, "options": {)" +
                              replay + "}}";
  write_file(run / "summary.json", summary);
  write_file(run / "journal.jsonl",
             R"({"event":"batch","time_s":1.0,"pairs":[[")" + std::to_string(make_key('b', 1)) + R"(",")" +
                 std::to_string(make_key('a', 0)) +
                 R"("]],"account":{"generated":3,"pruned":1,"computed":2}})"
                 "\n"
                 R"({"event":"estimate","time_s":2.0,"inliers":1,"account":{"generated":3,"computed":2}})"
                 "\n");

  const std::vector<std::string> about = {
      "world",   "mission", "method",        "seed",         "registration_time_s",
      "workers", "thin",    "after_mission", "mission_end_s"};
  std::vector<std::string> columns = about;
  columns.insert(columns.end(), {"time_s", "queued", "verified", "gnc_inliers", "true_inliers", "ate_m"});
  CsvText curves(columns), runs(columns);
  for (const double time_s : {1.0, 2.0}) {
    curves.row("cave", "seed", "full", 1, 1.0, 1, 1, 0, 10.0, time_s, 5, 4, 3, 2, 0.5);
  }
  runs.row("cave", "seed", "full", 1, 1.0, 1, 1, 0, 10.0, 10.0, 5, 4, 3, 2, 0.5);
  write_file(study / "curves.csv", curves.text());
  write_file(study / "runs.csv", runs.text());
  write_file(study / "robots.csv", runs.text());
  write_file(study / "ablation.json", "{\"units\": 1}\n");
  write_file(
      study / "units" / "one.json",
      R"({"format": 1, "mission": {"world": "cave"}, "summary": )" + summary +
          R"(, "history": [[1.0, 1, 3, 5, 4, 4, 3, 2, 2, 0.5, 0.9], [9.0, 1, 3, 5, 4, 4, 3, 2, 2, null, 0.9]]})");
}

const SeedFiles& seed_run_files() {
  static const SeedFiles files = {
      {"run", "summary.json"},           {"run", "closures.csv"},    {"run", "history.csv"},
      {"run", "journal.jsonl"},          {"run", "graph.g2o"},       {"run", "map.pcd"},
      {"run", "trajectories/husky.tum"}, {"study", "curves.csv"},    {"study", "runs.csv"},
      {"study", "robots.csv"},           {"study", "ablation.json"}, {"study", "units/one.json"}};
  return files;
}

}  // namespace loopwise::fuzz
