// SPDX-License-Identifier: BSD-3-Clause
#include "replay_arguments.hpp"

#include <loopwise/core/error.hpp>

namespace loopwise::cli {

void add_preset_option(Command& command, std::string& preset) {
  command
      .add_option("--preset", preset,
                  "Which nodes are candidates: paper, lamp_2022_01, lamp_base (default) or lamp_robot")
      ->type_name("NAME");
}

void add_batch_option(Command& command, std::optional<std::int64_t>& batch) {
  command.add_option("--batch", batch, "Candidates per batch; 0: by the modelled computer (default)")
      ->type_name("B");
}

void add_replay_arguments(Command& command, ReplayArguments& arguments) {
  add_preset_option(command, arguments.preset);
  command
      .add_option("--skip-recent", arguments.skip_recent, "Least index gap between two nodes of one robot")
      ->type_name("N");
  command
      .add_option("--candidates", arguments.candidates,
                  "Pairs of another place recognition: CSV with from,to and optionally score and the pose "
                  "x,y,z,qx,qy,qz,qw of `to` in the frame of `from`")
      ->type_name("FILE");
  command.add_flag("--appearance", arguments.appearance,
                   "Also propose nodes that look alike, at any distance in the estimate");
  command.add_option("--thin", arguments.thin, "Keep one candidate in N, drawn by pair and seed")
      ->type_name("N");
  add_batch_option(command, arguments.batch);
  command
      .add_option("--registration-time", arguments.registration_time,
                  "Mission time of one registration on one worker, s (default 1.3), or the word measured: "
                  "its time on this machine")
      ->type_name("S");
  command
      .add_option("--gi-evaluation-time", arguments.gi_evaluation_time,
                  "Mission time of one evaluation of graph information, s (default 0.02)")
      ->type_name("S");
  command.add_option("--max-registrations", arguments.max_registrations, "End after N registrations")
      ->type_name("N");
  command
      .add_option("--odometry-noise", arguments.odometry_noise,
                  "Add noise to the odometry: sigma after 1 m, in m and rad")
      ->type_name("M_PER_M RAD_PER_M")
      ->expected(2)
      ->allow_extra_args(false);
  command.add_option("--registrar", arguments.registrar, "Registration of candidates: fast (default) or pcl")
      ->type_name("WORD");
  command
      .add_option("--guess", arguments.guess, "Relative pose given to registrations: estimate or odometry")
      ->type_name("WORD");
  command
      .add_option("--outcomes", arguments.outcomes,
                  "Store outcomes of registrations in this folder, and reuse those in it")
      ->type_name("DIR")
      ->check(not_standard_output());
  command
      .add_option("--outcomes-mb", arguments.outcomes_bound.max_mb,
                  "Bound of that folder, MB; the oldest outcomes are removed first (default 4096)")
      ->type_name("MB")
      ->check(in_range(1.0, 1e9));
  add_robots_option(command, arguments.reading.robots);
  add_odometry_option(command, arguments.reading.odometry);
  add_decisions_option(command, arguments.decisions);
  add_seed_option(command, arguments.seed);
#ifdef LOOPWISE_HAS_MPI
  command
      .add_option(
          "--rank-time-limit", arguments.rank_time_limit_s,
          "Time after which a rank of an MPI job without an answer counts as dead, s (default: replays "
          "600, studies, whose answers are whole runs, 86400)")
      ->type_name("S")
      ->check(positive_number());
#endif
}

void apply(const ReplayArguments& a, Config& config) {
  ReplayOptions& replay = config.replay;
  if (!a.preset.empty()) replay.engine.generation = proximity_preset(a.preset);
  if (!a.candidates.empty()) replay.candidates = a.candidates;
  if (a.appearance) replay.appearance.enabled = true;
  if (a.skip_recent) replay.engine.generation.skip_recent = *a.skip_recent;
  apply(a.reading, config);
  if (!a.decisions.empty()) replay.decisions = a.decisions;
  if (!a.guess.empty()) replay.engine.guess = parse_enum<GuessSource>("--guess", a.guess);
  if (!a.registrar.empty()) {
    replay.registration.registrar = parse_enum<RegistrarKind>("--registrar", a.registrar);
  }
  if (a.batch) replay.batch = *a.batch;
  if (a.max_registrations) replay.max_registrations = *a.max_registrations;
  if (a.thin) replay.engine.thin = *a.thin;
  if (a.registration_time == "measured") {
    replay.cost.measured_time = true;
  } else if (!a.registration_time.empty()) {
    set_config_option("cost.registration_time_s=" + a.registration_time, config);
    replay.cost.measured_time = false;
  }
  if (a.gi_evaluation_time) replay.cost.gi_evaluation_time_s = *a.gi_evaluation_time;
  if (!a.odometry_noise.empty()) {
    replay.odometry_noise_m_per_m = a.odometry_noise[0];
    replay.odometry_noise_rad_per_m = a.odometry_noise[1];
  }
  if (a.seed) replay.engine.seed = *a.seed;
}

std::shared_ptr<OutcomeStore> open_store(const ReplayArguments& arguments) {
  if (arguments.outcomes.empty()) return nullptr;
  return std::make_shared<OutcomeStore>(arguments.outcomes, arguments.outcomes_bound);
}

void note_outcomes(Console& console, const OutcomeStoreStatistics& statistics) {
  console.note(std::to_string(statistics.hits) + " registrations taken from the stored outcomes, " +
               std::to_string(statistics.computed) + " computed");
  if (statistics.damaged_bytes > 0) {
    console.warn(std::to_string(statistics.damaged_bytes) +
                 " bytes of the stored outcomes were damaged and skipped");
  }
  if (!statistics.problem.empty()) console.warn("outcomes are no longer stored: " + statistics.problem);
}

}  // namespace loopwise::cli
