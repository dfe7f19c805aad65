// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/evaluation/trajectory_source.hpp>
#include <loopwise/evaluation/trajectory_text.hpp>

#include "command.hpp"
#include "evaluate_map.hpp"
#include "mission_options.hpp"
#include "units.hpp"

namespace loopwise::cli {
namespace {

struct EvaluateCommand {
  CommonOptions common;
  std::string estimate;
  std::string truth;
  std::string alignment = "none";
  std::string robots;
  double max_time_difference_s = 0.02;
  bool map = false;
};

TrajectoryPair read_input(const EvaluateCommand& options, const Config& config, Console& console,
                          const StopToken& stop) {
  TrajectoryPair input = read_trajectory_pair(options.estimate, options.truth, config.mission,
                                              console.progress_callback(), stop);
  if (input.odometry_is_truth) {
    console.warn(options.truth +
                 ": odometry and truth are the same poses, so errors say nothing about a map; give another "
                 "odometry, or judge a replay with --odometry-noise 0.05 0.01");
  }
  for (const Trajectory* trajectory : {&input.estimate, &input.truth}) {
    if (config.mission.strict) require_unaltered(trajectory->problems);
    console.warn(trajectory->problems);
  }
  return input;
}

std::string errors_text(const TrajectoryErrors& errors, std::size_t estimated) {
  std::string text = trajectory_errors_table(errors);
  if (errors.poses < estimated) {
    text += "\n" + std::to_string(estimated - errors.poses) + " of " + std::to_string(estimated) +
            " poses of the estimate have no match in the truth\n";
  }
  return text + "\nATE rmse " + fixed(errors.ate_m.rmse, 4) + " m, median " + fixed(errors.ate_m.median, 4) +
         " m (alignment: " + enum_name(errors.alignment) + ")\nRPE per step: mean " +
         fixed(errors.step.translation_m.mean, 4) + " m, " +
         fixed(errors.step.rotation_rad.mean * kDegreesPerRadian, 4) + " deg\n";
}

int run_evaluate(const EvaluateCommand& options) {
  if (options.map) return evaluate_map(options.common, options.estimate, options.truth, options.robots);
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  const Config config = load_config(options.common);
  const auto alignment = parse_enum<Alignment>("--alignment", options.alignment);
  const TrajectoryPair input = read_input(options, config, console, interrupt.token());
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
                 {"truth", input.truth.poses.size() - errors.poses}}}};
  json.update(parse_json(trajectory_errors_json(errors), "errors"));
  if (errors.applied.support != AlignmentSupport::kPositions) {
    console.warn(
        "positions are on one line or at one point, within their errors: the alignment also uses "
        "orientations");
  }
  print_results(options.common, json, errors_text(errors, input.estimate.poses.size()));
  return kDone;
}

}  // namespace

void add_evaluate(Command& app, Action& chosen) {
  const auto options = std::make_shared<EvaluateCommand>();
  Command* command = app.add_subcommand("evaluate", "Errors of a trajectory against the truth");
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
  Argument* const alignment =
      command
          ->add_option("--alignment", options->alignment,
                       "none: common frame; first: first poses agree; se3: best rigid motion (default none)")
          ->type_name("WORD");
  Argument* const map = command->add_flag(
      "--map", options->map,
      "Without truth: how well scans of TRUTH, a recording, agree at revisits, by its own poses and "
      "by those of ESTIMATE");
  add_robots_option(*command, options->robots);
  Argument* const gap = command
                            ->add_option("--max-time-difference", options->max_time_difference_s,
                                         "TUM: largest gap of paired stamps, s (default 0.02)")
                            ->type_name("S")
                            ->check(non_negative_number());
  map->excludes(alignment)->excludes(gap);
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_evaluate, chosen);
}

}  // namespace loopwise::cli
