// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/trajectory_source.hpp>

#include <string>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/graph_source.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {
namespace {

enum class Poses { kEstimate, kTruth };

/// The nodes of a recording as a trajectory, with their true poses or those of its graph.
Trajectory trajectory_of(const std::filesystem::path& path, const Mission& mission, Poses wanted,
                         bool by_stamp) {
  Trajectory trajectory;
  trajectory.format = by_stamp ? TrajectoryFormat::kTum : TrajectoryFormat::kG2o;
  trajectory.problems = mission.problems;
  for (const Node& node : mission.graph.nodes()) {
    const auto truth = mission.ground_truth.find(node.key);
    if (mission.robots.is_landmark(node.key)) continue;
    if (wanted == Poses::kTruth && truth == mission.ground_truth.end()) continue;
    trajectory.keys.push_back(node.key);
    trajectory.poses.push_back(wanted == Poses::kTruth ? truth->second : node.pose);
    if (by_stamp) trajectory.stamps_ns.push_back(node.stamp_ns);
  }
  if (trajectory.poses.empty()) {
    throw InputError(path.string() + ": no ground truth is recorded there" +
                     (mission.reference.empty() ? ""
                                                : "; the session's own optimised poses are another program's "
                                                  "result: give their file to compare with them"));
  }
  return trajectory;
}

bool is_odometry_true(const Mission& mission) {
  PosesByKey odometry;
  for (const Node& node : mission.graph.nodes()) {
    if (mission.ground_truth.count(node.key) != 0) odometry.emplace(node.key, node.pose);
  }
  if (odometry.empty()) return false;
  constexpr double kSame_m = 1e-6;
  return evaluate_trajectory(odometry, mission.ground_truth, Alignment::kNone, mission.robots).ate_m.max <=
         kSame_m;
}

/// Reports a run of another mission than that of the truth: equal keys would pair unrelated poses.
void compare_names(const std::filesystem::path& run, const std::string& truth_mission, Problems& problems) {
  const Json summary = read_json_file(run / "summary.json");
  if (!summary.is_object() || !summary.contains("mission") || !summary["mission"].is_string()) return;
  const auto name = summary["mission"].get<std::string>();
  if (name != truth_mission) {
    problems.add("truth of another mission than the run's",
                 "the run is of \"" + name + "\", the truth of \"" + truth_mission + "\"");
  }
}

}  // namespace

TrajectoryPair read_trajectory_pair(const std::filesystem::path& estimate_path,
                                    const std::filesystem::path& truth, const MissionOptions& options,
                                    const ProgressCallback& progress, const StopToken& stop) {
  const std::filesystem::path run = graph_of_run(estimate_path);
  const std::filesystem::path& estimate = run.empty() ? estimate_path : run;
  TrajectoryPair pair;
  std::string truth_mission;
  const bool recorded_estimate = is_recording(estimate), recorded_truth = is_recording(truth);
  if (!recorded_estimate) pair.estimate = read_trajectory(estimate);
  if (!recorded_truth) pair.truth = read_trajectory(truth);
  const auto read = [&](const std::filesystem::path& path, Poses wanted, bool by_stamp) {
    const Mission mission = read_mission(path, options, progress, stop);
    pair.robots = mission.robots;
    if (wanted == Poses::kTruth) truth_mission = mission.name;
    if (wanted == Poses::kTruth) pair.odometry_is_truth = is_odometry_true(mission);
    // The trajectory of a run has the stamps of its mission.
    if (by_stamp && wanted == Poses::kEstimate) require_own_stamps(mission, truth.string(), options);
    return trajectory_of(path, mission, wanted, by_stamp);
  };
  const auto by_stamp = [](bool recorded, const Trajectory& file) {
    return !recorded && file.format == TrajectoryFormat::kTum;
  };
  if (recorded_estimate) {
    pair.estimate = read(estimate, Poses::kEstimate, by_stamp(recorded_truth, pair.truth));
  }
  if (recorded_truth) {
    pair.truth = read(truth, Poses::kTruth, by_stamp(recorded_estimate, pair.estimate));
    if (!run.empty()) compare_names(estimate_path, truth_mission, pair.truth.problems);
  }
  // Pairs have the keys of the estimate; in a TUM file a key is a row number.
  if (!recorded_estimate && pair.estimate.format != TrajectoryFormat::kG2o) pair.robots = Robots();
  return pair;
}

}  // namespace loopwise
