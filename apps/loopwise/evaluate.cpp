// SPDX-License-Identifier: BSD-3-Clause
#include <filesystem>
#include <limits>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

#include "command.hpp"
#include "evaluate_map.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::string estimate;
  std::string truth;
  std::string alignment = "none";
  std::string robots;
  double max_time_difference_s = 0.02;
  bool map = false;
};

Json statistics_json(const Statistics& s) {
  return {{"rmse", s.rmse}, {"mean", s.mean}, {"median", s.median}, {"max", s.max}};
}

Json relative_json(const RelativeErrors& e) {
  return {{"count", e.translation_m.count},
          {"translation_m", statistics_json(e.translation_m)},
          {"rotation_rad", statistics_json(e.rotation_rad)},
          {"translation_percent", e.translation_percent},
          {"rotation_deg_per_m", e.rotation_deg_per_m}};
}

enum class Poses { kEstimate, kTruth };

struct Input {
  Trajectory estimate, truth;
  Robots robots;  ///< Of the recording if pairs have its keys; empty: one robot per character in keys.
};

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

/// Warns if odometry equals the true poses: errors against them then say nothing about a map.
void warn_if_odometry_is_truth(const std::filesystem::path& path, const Mission& mission, Console& console) {
  PosesByKey odometry;
  for (const Node& node : mission.graph.nodes()) {
    if (mission.ground_truth.count(node.key) != 0) odometry.emplace(node.key, node.pose);
  }
  if (odometry.empty()) return;
  constexpr double kSame_m = 1e-6;
  if (evaluate_trajectory(odometry, mission.ground_truth, Alignment::kNone, mission.robots).ate_m.max >
      kSame_m)
    return;
  console.warn(path.string() +
               ": odometry and truth are the same poses, so errors say nothing about a map; give another "
               "odometry, or judge a replay with --odometry-noise 0.05 0.01");
}

/// Reads both trajectories. A recording is paired with the other trajectory by key, or by stamp if that is a
/// TUM file.
Input read_input(const Options& options, const Config& config, Console& console, const StopToken& stop) {
  const std::filesystem::path run = graph_of_run(options.estimate);
  const std::filesystem::path estimate = run.empty() ? std::filesystem::path(options.estimate) : run;
  const std::filesystem::path truth = options.truth;
  Input input;
  const bool recorded_estimate = is_recording(estimate), recorded_truth = is_recording(truth);
  if (!recorded_estimate) input.estimate = read_trajectory(estimate);
  if (!recorded_truth) input.truth = read_trajectory(truth);
  const auto read = [&](const std::filesystem::path& path, Poses wanted, bool by_stamp) {
    const Mission mission = read_mission(path, config.mission, console.progress_callback(), stop);
    input.robots = mission.robots;
    if (wanted == Poses::kTruth) warn_if_odometry_is_truth(path, mission, console);
    // The trajectory of a run has the stamps of its mission.
    if (by_stamp && wanted == Poses::kEstimate) require_own_stamps(mission, options.truth, config.mission);
    return trajectory_of(path, mission, wanted, by_stamp);
  };
  const auto by_stamp = [](bool recorded, const Trajectory& file) {
    return !recorded && file.format == TrajectoryFormat::kTum;
  };
  if (recorded_estimate) {
    input.estimate = read(estimate, Poses::kEstimate, by_stamp(recorded_truth, input.truth));
  }
  if (recorded_truth) {
    input.truth = read(truth, Poses::kTruth, by_stamp(recorded_estimate, input.estimate));
  }
  // Pairs have the keys of the estimate; in a TUM file a key is a row number.
  if (!recorded_estimate && input.estimate.format != TrajectoryFormat::kG2o) input.robots = Robots();
  return input;
}

int run(const Options& options) {
  if (options.map) return evaluate_map(options.common, options.estimate, options.truth, options.robots);
  constexpr double kDegrees = 57.29577951308232;
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  const Config config = load_config(options.common);
  const auto alignment = parse_enum<Alignment>("--alignment", options.alignment);
  const Input input = read_input(options, config, console, interrupt.token());
  for (const Trajectory* trajectory : {&input.estimate, &input.truth}) {
    if (config.mission.strict) require_unaltered(trajectory->problems);
    console.warn(trajectory->problems);
  }
  const PosePairs pairs = associate(input.estimate, input.truth, options.max_time_difference_s);
  console.warn(pairs.problems);

  PosesByKey estimated, true_poses;
  for (std::size_t i = 0; i < pairs.keys.size(); ++i) {
    estimated[pairs.keys[i]] = pairs.estimate[i];
    true_poses[pairs.keys[i]] = pairs.truth[i];
  }
  const Robots robots = options.robots.empty() ? input.robots : parse_robots(options.robots);
  const TrajectoryErrors errors = evaluate_trajectory(estimated, true_poses, alignment, robots);

  Json json = {{"poses", errors.poses},
               {"unpaired",
                {{"estimate", input.estimate.poses.size() - errors.poses},
                 {"truth", input.truth.poses.size() - errors.poses}}},
               {"alignment", options.alignment},
               {"ate_m", statistics_json(errors.ate_m)},
               {"ate_rad", statistics_json(errors.ate_rad)},
               {"rpe", relative_json(errors.step)}};
  Json distances = Json::array();
  for (const RelativeErrors& e : errors.by_distance) {
    Json entry = relative_json(e);
    entry["distance_m"] = e.distance_m;
    distances.push_back(entry);
  }
  json["rpe_by_distance"] = distances;
  Json by_robot = Json::object();
  std::vector<std::vector<std::string>> rows{{"robot", "poses", "length m", "ATE mean m", "max m", "mean deg",
                                              "max deg", "transl. %", "rot. deg/m"}};
  const auto add_row = [&rows](const std::string& name, std::size_t poses, double length, const Statistics& m,
                               const Statistics& rad, double percent, double deg_per_m) {
    rows.push_back({name, std::to_string(poses), fixed(length, 1), fixed(m.mean, 3), fixed(m.max, 3),
                    fixed(rad.mean * kDegrees, 3), fixed(rad.max * kDegrees, 3), fixed(percent, 2),
                    fixed(deg_per_m, 3)});
  };
  double length = 0.0;
  for (const RobotErrors& robot : errors.robots) {
    by_robot[robot.name] = {{"poses", robot.poses},
                            {"path_length_m", robot.path_length_m},
                            {"ate_m", statistics_json(robot.ate_m)},
                            {"ate_rad", statistics_json(robot.ate_rad)},
                            {"rpe", relative_json(robot.step)},
                            {"translation_percent", robot.translation_percent},
                            {"rotation_deg_per_m", robot.rotation_deg_per_m}};
    add_row(robot.name, robot.poses, robot.path_length_m, robot.ate_m, robot.ate_rad,
            robot.translation_percent, robot.rotation_deg_per_m);
    length += robot.path_length_m;
  }
  json["robots"] = by_robot;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  add_row("all", errors.poses, length, errors.ate_m, errors.ate_rad, nan, nan);
  std::string text = table(rows);
  if (const std::size_t all = input.estimate.poses.size(); errors.poses < all) {
    text += "\n" + std::to_string(all - errors.poses) + " of " + std::to_string(all) +
            " poses of the estimate have no match in the truth\n";
  }
  text += "\nATE rmse " + fixed(errors.ate_m.rmse, 4) + " m, median " + fixed(errors.ate_m.median, 4) +
          " m (alignment: " + options.alignment + ")\nRPE per step: mean " +
          fixed(errors.step.translation_m.mean, 4) + " m, " +
          fixed(errors.step.rotation_rad.mean * kDegrees, 4) + " deg\n";
  if (errors.applied.support != AlignmentSupport::kPositions) {
    console.warn(
        "positions are on one line or at one point, within their errors: the alignment also uses "
        "orientations");
  }
  print_results(options.common, json, text);
  return kDone;
}

}  // namespace

void add_evaluate(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("evaluate", "Errors of a trajectory against the truth");
  command->footer(
      "Both may be TUM (paired by stamp), KITTI (by row) or g2o (by key), the estimate a run's folder, and "
      "both\n"
      "a recording of any kind: its graph is the estimate, its ground truth the truth.\n"
      "  loopwise evaluate out my_mission\n"
      "  loopwise evaluate out/trajectories/husky.tum truth.tum --alignment se3\n"
      "With --map ESTIMATE is a run's folder, a g2o file or a recording with the same keys, TRUTH a "
      "recording "
      "with\n"
      "scans: errors are not known then, but maps can be compared.\n"
      "  loopwise evaluate --map out my_mission");
  command->add_option("estimate", options->estimate, "Estimated trajectory or graph, a run, or a recording")
      ->required()
      ->type_name("ESTIMATE");
  command->add_option("truth", options->truth, "True trajectory or graph, or a recording")
      ->required()
      ->type_name("TRUTH");
  CLI::Option* const alignment =
      command
          ->add_option("--alignment", options->alignment,
                       "none: common frame; first: first poses agree; se3: best rigid motion (default none)")
          ->type_name("WORD");
  CLI::Option* const map = command->add_flag(
      "--map", options->map,
      "Without truth: how well scans of TRUTH, a recording, agree at revisits, by its own poses and "
      "by those of ESTIMATE");
  command->add_option("--robots", options->robots, "Robots by ranges of ids or by characters")
      ->type_name("LIST");
  CLI::Option* const gap = command
                               ->add_option("--max-time-difference", options->max_time_difference_s,
                                            "TUM: largest gap of paired stamps, s (default 0.02)")
                               ->type_name("S")
                               ->check(CLI::NonNegativeNumber);
  map->excludes(alignment)->excludes(gap);
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
