// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/study/acceptance.hpp>

#include "study_arguments.hpp"

namespace loopwise::cli {
namespace {

struct AcceptanceArguments {
  CommonOptions common;
  ReplayArguments replay;
  std::vector<std::string> missions;
  std::string output;
};

int run_acceptance_study(const AcceptanceArguments& a) {
  Console console(a.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(a.common, study::study_config());
  apply(a.replay, config);
  validate_config(config);
  ReplayHooks hooks;
  hooks.progress = console.progress_callback();
  hooks.stop = interrupt.token();
  const std::shared_ptr<OutcomeStore> store = open_store(a.replay);
  ThreadPool threads(thread_count(a.common));
  std::vector<AcceptanceSamples> samples;
  for (const std::string& path : a.missions) {
    if (interrupt.interrupted()) break;
    const Mission mission = read_mission(path, config.mission, hooks.progress);
    console.warn(mission.problems);
    samples.push_back(collect_acceptance(
        mission, config.replay, make_registration(config.replay.registration, mission.scans->loader(), store),
        threads, hooks));
  }
  if (interrupt.interrupted()) {
    console.warn("interrupted: nothing was fitted; registrations in --outcomes are kept");
    return kInterrupted;
  }
  const study::AcceptanceReport report = study::fit_chances(samples);
  for (const std::string& problem : report.problems) console.warn(problem);
  if (!a.output.empty()) write_file(a.output, report.weights);
  print_json_text(a.common, report.json, report.markdown);
  return kDone;
}

}  // namespace

void add_acceptance_study(Command& app, Action& chosen) {
  const auto options = std::make_shared<AcceptanceArguments>();
  Command* command =
      app.add_subcommand("acceptance", "Fit the chances of method expected to missions, and judge the fit");
  command->footer(
      "Replays each mission with candidates in random order and fits how likely a candidate is verified, "
      "and\n"
      "a verified closure kept, to the results. Scores are of missions that were left out of the fit.\n"
      "  loopwise study acceptance mine-* -o chances.json --max-registrations 3000\n"
      "  loopwise replay MISSION -o out --config chances.json");
  command->add_option("missions", options->missions, "Missions; ground truth is not needed")
      ->required()
      ->type_name("MISSION");
  command->add_option("-o,--output", options->output, "Write the weights to FILE, for --config")
      ->type_name("FILE");
  add_replay_arguments(*command, options->replay);
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_acceptance_study, chosen);
}

}  // namespace loopwise::cli
