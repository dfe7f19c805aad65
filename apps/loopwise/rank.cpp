// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/replay/rank.hpp>

#include "command.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::string mission, output, method, preset, candidates, robots, odometry, decisions, bin_layout;
  std::optional<std::int64_t> batch;
  std::optional<std::uint64_t> seed;
  RankOptions rank;
};

constexpr std::size_t kShown = 20;

Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

int run(const Options& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  if (!options.preset.empty()) config.replay.engine.generation = proximity_preset(options.preset);
  if (!options.candidates.empty()) config.replay.candidates = options.candidates;
  if (!options.robots.empty()) config.mission.robots = options.robots;
  set_odometry(options.odometry, config);
  if (!options.decisions.empty()) config.replay.decisions = options.decisions;
  apply_bin_layout(options.bin_layout, config);
  if (!options.method.empty()) config.replay.prioritization.method = parse_method(options.method);
  if (options.batch) config.replay.batch = *options.batch;
  if (options.seed) config.replay.engine.seed = *options.seed;
  config.replay.prioritization.closure_model.threads = thread_count(options.common);
  validate_config(config);
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

  if (!options.output.empty()) {
    CsvText csv({"rank", "from", "to", "source", "distance_m", "observability_from", "observability_to",
                 "gain_m2", "connecting", "refused"});
    for (const CandidateScores& s : ranking.candidates) {
      csv.row(s.rank ? std::to_string(*s.rank) : "", s.candidate.from, s.candidate.to,
              enum_name(s.candidate.source), s.candidate.distance_m, s.observability_from, s.observability_to,
              s.gain_m2, s.connecting ? 1 : 0, s.refused);
    }
    write_file(options.output, csv.text());
  }

  Json json = Json::object();
  json["mission"] = mission.name;
  json["method"] = to_string(config.replay.prioritization.method);
  json["seed"] = config.replay.engine.seed;
  json["candidates"] = ranking.candidates.size();
  json["ranked"] = ranking.ranked;
  json["refused"] = ranking.refused;
  json["gains_exact"] = ranking.gains_exact;
  json["trace_m2"] = {{"now", number(ranking.trace_m2)}, {"with_ranked", number(ranking.trace_ranked_m2)}};
  json["order"] = Json::array();
  std::vector<std::vector<std::string>> rows{
      {"rank", "from", "to", "source", "distance", "observability", "gain (m²)"}};
  for (const CandidateScores& s : ranking.candidates) {
    if (!s.rank) break;
    json["order"].push_back({{"rank", *s.rank},
                             {"from", std::to_string(s.candidate.from)},
                             {"to", std::to_string(s.candidate.to)},
                             {"source", enum_name(s.candidate.source)},
                             {"distance_m", s.candidate.distance_m},
                             {"observability", {number(s.observability_from), number(s.observability_to)}},
                             {"gain_m2", number(s.gain_m2)},
                             {"connecting", s.connecting}});
    if (*s.rank > kShown) continue;
    rows.push_back({std::to_string(*s.rank), key_name(s.candidate.from), key_name(s.candidate.to),
                    enum_name(s.candidate.source), fixed(s.candidate.distance_m, 1),
                    fixed(s.observability_from + s.observability_to, 3),
                    s.connecting ? "connects" : fixed(s.gain_m2, 4)});
  }
  std::string text = table(rows);
  if (ranking.ranked > kShown) text += "... " + std::to_string(ranking.ranked - kShown) + " more ranked\n";
  text += std::to_string(ranking.candidates.size()) + " candidates, " + std::to_string(ranking.ranked) +
          " ranked by method " + to_string(config.replay.prioritization.method);
  for (const auto& [reason, count] : ranking.refused)
    text += ", " + std::to_string(count) + " refused: " + reason;
  text += "\ntrace of the covariances " + fixed(ranking.trace_m2, 4) + " m² now, " +
          fixed(ranking.trace_ranked_m2, 4) + " m² with closures at the ranked\n";
  print_results(options.common, json, text);
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace

void add_rank(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("rank", "List the loop candidates of a mission with their scores");
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
  command->add_option("--batch", options->batch, "Candidates per batch")->type_name("B");
  command->add_option("--count", options->rank.count, "Candidates to rank (default: one batch)")
      ->type_name("N")
      ->check(not_negative());
  command
      ->add_option("--evaluations", options->rank.evaluations,
                   "Sets that graph information may try for each batch (default 1000)")
      ->type_name("N")
      ->check(not_negative());
  command
      ->add_option("--preset", options->preset,
                   "Which nodes are candidates: paper, lamp_2022_01, lamp_base (default) or lamp_robot")
      ->type_name("NAME");
  command
      ->add_option("--candidates", options->candidates,
                   "Pairs of another place recognition, which are candidates too: CSV with from,to and "
                   "optionally score and x,y,z,qx,qy,qz,qw")
      ->type_name("FILE");
  add_bin_layout_option(*command, options->bin_layout);
  command->add_option("--robots", options->robots, "Robots by ranges of ids or by characters")
      ->type_name("LIST");
  add_odometry_option(*command, options->odometry);
  add_decisions_option(*command, options->decisions);
  command->add_option("--seed", options->seed, "Seed of all random draws (default 1)")
      ->type_name("S")
      ->check(not_negative());
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
