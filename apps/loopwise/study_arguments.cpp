// SPDX-License-Identifier: BSD-3-Clause
#include "study_arguments.hpp"

#include <loopwise/io/atomic_file.hpp>

namespace loopwise::cli {

void add_study_arguments(Command& command, StudyArguments& arguments) {
  command
      .add_option("missions", arguments.missions,
                  "Missions with ground truth, own or given by --truth; those of one world are repetitions")
      ->required()
      ->type_name("MISSION");
  command.add_option("-o,--output", arguments.output, "Folder for the tables, the units and what they share")
      ->required()
      ->type_name("DIR")
      ->check(not_standard_output());
  command
      .add_option("--seeds", arguments.seeds,
                  "Replay each mission with this many seeds, from --seed on (default 1)")
      ->type_name("N")
      ->check(in_range(1, 100000));
  add_truth_option(command, arguments.truth);
  add_replay_arguments(command, arguments.replay);
  command.add_flag("--keep-runs", arguments.keep_runs,
                   "Keep each run's folder, as replay writes it, in DIR/runs");
  command.add_flag("--resume", arguments.resume,
                   "Continue in DIR; its finished runs are never computed again anyway");
  add_key_frame_options(command, arguments.common);
  add_common_options(command, arguments.common);
}

study::StudyOptions study_options(const StudyArguments& arguments) {
  study::StudyOptions options;
  options.config = load_config(arguments.common, study::study_config());
  apply(arguments.replay, options.config);
  validate_config(options.config);
  for (std::size_t i = 0; i < arguments.missions.size(); ++i) {
    options.missions.push_back(
        {arguments.missions[i], truth_of_mission(arguments.truth, i, arguments.missions.size())});
  }
  options.folder = arguments.output;
  options.seeds = arguments.seeds;
  options.keep_runs = arguments.keep_runs;
  options.resume = arguments.resume;
  options.threads = arguments.common.threads;
  options.outcomes = arguments.replay.outcomes;
  options.outcomes_bound = arguments.replay.outcomes_bound;
  options.job = arguments.job;
  options.rank_time_limit_s = arguments.replay.rank_time_limit_s.value_or(options.rank_time_limit_s);
  return options;
}

int run_study(const StudyArguments& arguments, const std::string& name, const std::string& csv,
              const std::function<std::optional<study::StudyReport>(const study::StudyOptions&,
                                                                    const study::StudyHooks&)>& run) {
  Console console(arguments.common.quiet);
  const InterruptGuard interrupt;
  study::StudyHooks hooks;
  hooks.progress = console.progress_callback();
  hooks.note = [&](const std::string& text) { console.note(text); };
  hooks.warn = [&](const std::string& text) { console.warn(text); };
  hooks.outcomes = [&](const OutcomeStoreStatistics& statistics) { note_outcomes(console, statistics); };
  hooks.stop = interrupt.token();
  const study::StudyOptions options = study_options(arguments);
  const auto report = run(options, hooks);
  if (!report) return study::serves(options) ? kDone : kInterrupted;
  write_file(options.folder / csv, report->csv);
  write_file(options.folder / (name + ".json"), report->json);
  write_file(options.folder / (name + ".md"), report->markdown);
  print_json_text(arguments.common, report->json, report->markdown);
  return kDone;
}

}  // namespace loopwise::cli
