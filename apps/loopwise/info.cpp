// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/mission_picture.hpp>
#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/cost_forecast.hpp>

#include "command.hpp"
#include "mission_text.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::vector<std::string> paths, truth;
  std::string frames;
  std::string bin_layout;
  bool start_together = false;
  std::string robots;
  std::string picture;
  CandidateStatisticsOptions candidates;
  std::int64_t timed = 40;
  bool read_scans = true;
};

PointCounts count_points(const ScanStore& scans, Console& console, const StopToken& stop) {
  PointCounts counts;
  const std::vector<Key> keys = scans.keys();
  for (std::size_t i = 0; i < keys.size() && !stop.stop_requested(); ++i) {
    try {
      const auto cloud = scans.load(keys[i]);
      if (!cloud) continue;
      counts.fewest = counts.scans == 0 ? cloud->size() : std::min(counts.fewest, cloud->size());
      counts.most = std::max(counts.most, cloud->size());
      counts.total += cloud->size();
      ++counts.scans;
    } catch (const Error&) {
      // The scan store counts it among its problems.
    }
    console.progress({"reading scans", i + 1, keys.size(), ""});
  }
  return counts;
}

int cloud_info(const Options& options, const Config& config, Console& console) {
  const CloudFile file = read_cloud(options.paths.front(), config.mission.bin_layout);
  console.warn(file.problems);
  Json problems = Json::array();
  for (const Problem& problem : file.problems.all()) problems.push_back(to_string(problem));
  const Eigen::Vector3d& origin = file.cloud.origin;
  const Json json = {{"kind", "cloud"},
                     {"origin_m", {origin.x(), origin.y(), origin.z()}},
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
                     {"problems", problems}};
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

Json number(double value) {
  return std::isnan(value) ? Json() : Json(value);
}

/// Adds the number of candidates by proximity, and the number of those that saw the same place.
void add_candidates(const Mission& mission, const Options& options, Json& json, std::string& text) {
  CandidateStatisticsOptions wanted = options.candidates;
  wanted.threads = thread_count(options.common);
  if (!options.read_scans) wanted.pairs = 0;
  const CandidateStatistics found = candidate_statistics(mission, wanted);
  json["candidates"] = {{"radius_m", wanted.radius_m},
                        {"generated", found.candidates},
                        {"looked_at", found.looked_at},
                        {"mean_overlap", number(found.mean_overlap)},
                        {"overlapping", number(found.overlapping)},
                        {"within_radius", number(found.within_radius)}};
  text += "pairs        " + std::to_string(found.candidates) + " of nodes within " +
          fixed(wanted.radius_m, 0) + " m";
  if (found.looked_at > 0) {
    text += "; the scans of " + fixed(100.0 * found.overlapping, 1) +
            " % overlap at the true poses (sample of " + std::to_string(found.looked_at) + ")";
  }
  text += "\n";
}

/// Adds the time that all of them would take on this machine.
void add_cost(const Mission& mission, const Options& options, const ReplayOptions& replay,
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

int run(const Options& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  if (!options.robots.empty()) config.mission.robots = options.robots;
  if (!options.frames.empty()) config.mission.frames = options.frames;
  if (options.start_together) config.mission.start_together = true;
  apply_bin_layout(options.bin_layout, config);
  const std::vector<std::filesystem::path> paths(options.paths.begin(), options.paths.end());
  if (paths.size() == 1 && std::filesystem::is_regular_file(paths[0]) && is_cloud_file(paths[0])) {
    return cloud_info(options, config, console);
  }
  Mission mission = read_missions(paths, config.mission, console.progress_callback(), interrupt.token());
  set_truth(mission, options.truth, config.mission);
  const PointCounts points =
      options.read_scans ? count_points(*mission.scans, console, interrupt.token()) : PointCounts{};

  Problems problems = mission.problems;
  problems.add(mission.scans->problems());
  Json json;
  std::string text;
  describe_mission(mission, points, problems, json, text);
  add_candidates(mission, options, json, text);
  add_cost(mission, options, config.replay, interrupt.token(), json, text);
  add_drift(mission, json, text);
  add_topics(mission, json, text);
  if (!options.picture.empty()) write_file(options.picture, mission_picture_svg(mission));
  for (const Problem& problem : problems.all()) text += "problem      " + to_string(problem) + "\n";
  print_results(options.common, json, text);
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace

void add_info(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("info", "Describe a mission, session, graph or cloud");
  command->footer("  loopwise info my_mission --picture my_mission.svg");
  command
      ->add_option("path", options->paths,
                   "Mission folder, session, g2o file, g2o_pcd folder, bag, saved map or cloud; several "
                   "bags, or several missions of one robot, are read as one")
      ->required()
      ->type_name("PATH");
  command->add_option("--robots", options->robots, "Robots by ranges of ids or by characters")
      ->type_name("LIST");
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
      ->check(CLI::Range(0, 1000000))
      ->type_name("N");
  add_joining_options(*command, options->frames, options->start_together);
  add_truth_option(*command, options->truth);
  add_bin_layout_option(*command, options->bin_layout);
  command->add_option("--picture", options->picture, "Draw the mission from above, as SVG")
      ->type_name("FILE")
      ->check(not_standard_output());
  command->add_flag("!--no-scans", options->read_scans, "Do not open the scans");
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
