// SPDX-License-Identifier: BSD-3-Clause
#include <cstdint>
#include <optional>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/replay/rank.hpp>

#include "command.hpp"
#include "mission_options.hpp"
#include "ranking_text.hpp"
#include "replay_arguments.hpp"

namespace loopwise::cli {
namespace {

struct RankCommand {
  CommonOptions common;
  std::string mission, output, method, preset, candidates, decisions;
  MissionArguments reading;
  std::optional<std::int64_t> batch;
  std::optional<std::uint64_t> seed;
  RankOptions rank;
};

Config config_of(const RankCommand& options) {
  Config config = load_config(options.common);
  ReplayOptions& replay = config.replay;
  if (!options.preset.empty()) replay.engine.generation = proximity_preset(options.preset);
  if (!options.candidates.empty()) replay.candidates = options.candidates;
  apply(options.reading, config);
  if (!options.decisions.empty()) replay.decisions = options.decisions;
  if (!options.method.empty()) replay.prioritization.method = parse_method(options.method);
  if (options.batch) replay.batch = *options.batch;
  if (options.seed) replay.engine.seed = *options.seed;
  replay.prioritization.closure_model.threads = thread_count(options.common);
  validate_config(config);
  return config;
}

int run_rank(const RankCommand& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  const Config config = config_of(options);
  const Mission mission =
      read_mission(options.mission, config.mission, console.progress_callback(), interrupt.token());
  console.warn(mission.problems);

  std::shared_ptr<FeatureCache> features;
  if (!mission.scans->empty()) {
    features = std::make_shared<FeatureCache>(mission.scans->loader(), config.replay.registration.features);
  }
  const Ranking ranking = rank_candidates(mission, config.replay, features, options.rank,
                                          console.progress_callback(), interrupt.token());
  if (!ranking.problem.empty()) console.warn("no gains: " + ranking.problem);
  console.warn(mission.scans->problems());
  if (features) console.warn(features->problems());

  if (!options.output.empty()) write_file(options.output, ranking_csv(ranking));
  const std::string method = to_string(config.replay.prioritization.method);
  Json json = {{"mission", mission.name}, {"method", method}, {"seed", config.replay.engine.seed}};
  json.update(ranking_json(ranking));
  print_results(options.common, json, ranking_text(ranking, method));
  if (config.mission.strict) require_unaltered(mission.scans->problems());
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace

void add_rank(Command& app, Action& chosen) {
  const auto options = std::make_shared<RankCommand>();
  Command* command = app.add_subcommand("rank", "List the loop candidates of a mission with their scores");
  command->footer(
      "Shows in which order a method would compute the candidates, and why. The graph is used unchanged: "
      "a\n"
      "mission's odometry, or the graph.g2o of a run.\n"
      "  loopwise rank my_mission --method full -o candidates.csv\n"
      "candidates.csv holds all candidates, the ranked ones first.");
  command
      ->add_option("mission", options->mission,
                   "Mission folder, session, g2o file, g2o_pcd folder, bag or saved map")
      ->required()
      ->type_name("MISSION");
  command->add_option("-o,--output", options->output, "Table of all candidates")
      ->type_name("FILE.csv")
      ->check(not_standard_output());
  command
      ->add_option(
          "--method", options->method,
          "expected (default), likely, obs, gi, full, rssi, random, baseline, or several joined by +")
      ->type_name("M");
  add_batch_option(*command, options->batch);
  command->add_option("--count", options->rank.count, "Candidates to rank (default: one batch)")
      ->type_name("N")
      ->check(not_negative());
  command
      ->add_option("--evaluations", options->rank.evaluations,
                   "Sets that graph information may try for each batch (default 1000)")
      ->type_name("N")
      ->check(not_negative());
  add_preset_option(*command, options->preset);
  command
      ->add_option("--candidates", options->candidates,
                   "Pairs of another place recognition, which are candidates too: CSV with from,to and "
                   "optionally score and x,y,z,qx,qy,qz,qw")
      ->type_name("FILE");
  add_bin_layout_option(*command, options->reading.bin_layout);
  add_robots_option(*command, options->reading.robots);
  add_odometry_option(*command, options->reading.odometry);
  add_decisions_option(*command, options->decisions);
  add_seed_option(*command, options->seed);
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_rank, chosen);
}

}  // namespace loopwise::cli
