// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/mission_picture.hpp>
#include <loopwise/evaluation/mission_summary.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/cost_forecast.hpp>

#include "command.hpp"
#include "mission_options.hpp"
#include "mission_text.hpp"

namespace loopwise::cli {
namespace {

struct InfoCommand {
  CommonOptions common;
  std::vector<std::string> paths, truth;
  MissionArguments reading;
  std::string picture;
  CandidateStatisticsOptions candidates;
  std::int64_t timed = 40;
  bool read_scans = true;
};

int cloud_info(const InfoCommand& options, const Config& config, Console& console) {
  const CloudFile file = read_cloud(options.paths.front(), config.mission.bin_layout);
  console.warn(file.problems);
  const Eigen::Vector3d& origin = file.cloud.origin;
  const Json json = {{"kind", "cloud"},
                     {"origin_m", row_major_json(origin)},
                     {"robots", Json::array()},
                     {"nodes", 0},
                     {"edges", 0},
                     {"scans", 1},
                     {"points",
                      {{"total", file.cloud.size()},
                       {"min", file.cloud.size()},
                       {"mean", file.cloud.size()},
                       {"max", file.cloud.size()}}},
                     {"length_m", 0.0},
                     {"duration_s", 0.0},
                     {"problems", problems_json(file.problems)}};
  print_results(
      options.common, json,
      "cloud        " + std::to_string(file.cloud.size()) + " points" +
          (file.cloud.has_normals() ? ", normals" : "") +
          (file.cloud.intensities.empty() ? "" : ", intensity") + "\n" +
          (origin.isZero(0.0) ? ""
                              : "origin       " + fixed(origin.x(), 0) + " " + fixed(origin.y(), 0) + " " +
                                    fixed(origin.z(), 0) + " m: world coordinates\n"));
  return kDone;
}

/// Adds the time that all of them would take on this machine.
void add_cost(const Mission& mission, const InfoCommand& options, const ReplayOptions& replay,
              const StopToken& stop, Json& json, std::string& text) {
  if (!options.read_scans || options.timed <= 0 || mission.scans->size() == 0) return;
  const CostForecast forecast = forecast_cost(mission, replay, static_cast<std::size_t>(options.timed), stop);
  const int threads = thread_count(options.common);
  if (forecast.measured == 0) return;
  json["all_candidates"] = {{"candidates", forecast.candidates},         {"measured", forecast.measured},
                            {"registration_s", forecast.registration_s}, {"threads", threads},
                            {"all_s", forecast.all_s(threads)},          {"mission_s", forecast.mission_s}};
  text += "all of them  " + forecast_text(forecast, threads) + "\n";
}

int run_info(const InfoCommand& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  apply(options.reading, config);
  const std::vector<std::filesystem::path> paths(options.paths.begin(), options.paths.end());
  if (paths.size() == 1 && std::filesystem::is_regular_file(paths[0]) && is_cloud_file(paths[0])) {
    return cloud_info(options, config, console);
  }
  Mission mission = read_missions(paths, config.mission, console.progress_callback(), interrupt.token());
  set_truth(mission, options.truth, config.mission);
  const PointCounts points =
      options.read_scans ? count_points(*mission.scans, interrupt.token(), console.progress_callback())
                         : PointCounts{};
  const MissionSummary summary = summarize_mission(mission, points);
  Json json = parse_json(mission_summary_json(summary), "summary");
  std::string text = mission_summary_text(summary);
  CandidateStatisticsOptions candidates = options.candidates;
  candidates.threads = thread_count(options.common);
  if (!options.read_scans) candidates.pairs = 0;
  add_candidates(mission, candidates, json, text);
  add_cost(mission, options, config.replay, interrupt.token(), json, text);
  add_drift(mission, json, text);
  add_topics(mission, json, text);
  if (!options.picture.empty()) write_file(options.picture, mission_picture_svg(mission));
  for (const Problem& problem : summary.problems.all()) text += "problem      " + to_string(problem) + "\n";
  print_results(options.common, json, text);
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace

void add_info(Command& app, Action& chosen) {
  const auto options = std::make_shared<InfoCommand>();
  Command* command = app.add_subcommand("info", "Describe a mission, session, graph or cloud");
  command->footer("  loopwise info my_mission --picture my_mission.svg");
  command
      ->add_option("path", options->paths,
                   "Mission folder, session, g2o file, g2o_pcd folder, bag, saved map or cloud; several "
                   "bags, or several missions of one robot, are read as one")
      ->required()
      ->type_name("PATH");
  add_robots_option(*command, options->reading.robots);
  command
      ->add_option("--radius", options->candidates.radius_m, "Count candidates within M metres (default 30)")
      ->type_name("M");
  command
      ->add_option("--pairs", options->candidates.pairs,
                   "Candidates whose scans are compared at the true poses (default 1000)")
      ->type_name("N");
  command
      ->add_option("--timed", options->timed,
                   "Candidates to register, to estimate the time of all of them; 0: no estimate (default 40)")
      ->check(in_range(0, 1000000))
      ->type_name("N");
  add_joining_options(*command, options->reading);
  add_truth_option(*command, options->truth);
  add_bin_layout_option(*command, options->reading.bin_layout);
  command->add_option("--picture", options->picture, "Draw the mission from above, as SVG")
      ->type_name("FILE")
      ->check(not_standard_output());
  command->add_flag("!--no-scans", options->read_scans, "Do not open the scans");
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_info, chosen);
}

}  // namespace loopwise::cli
