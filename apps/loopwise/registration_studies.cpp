// SPDX-License-Identifier: BSD-3-Clause
// The studies that register pairs: registration and acceptance.
#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/study/acceptance.hpp>
#include <loopwise/study/registration.hpp>

#include "study_arguments.hpp"

namespace loopwise::cli {
namespace {

struct RegistrationArguments {
  CommonOptions common;
  std::string mission, registrar = "both", preset, csv, markdown;
  std::vector<std::string> truth;
  study::RegistrationStudyOptions study;
  bool no_guess = false;
};

int run(RegistrationArguments a) {
  const Stopwatch watch;
  Console console(a.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(a.common);
  if (!a.preset.empty()) config.replay.engine.generation = proximity_preset(a.preset);
  if (a.no_guess) config.replay.engine.task.use_guess = false;
  if (a.registrar != "both") a.study.registrars = {parse_enum<RegistrarKind>("--registrar", a.registrar)};
  a.study.threads = thread_count(a.common);
  Mission mission = read_mission(a.mission, config.mission, console.progress_callback(), interrupt.token());
  set_truth(mission, a.truth, config.mission);
  console.warn(mission.problems);
  require_truth(a.mission, mission);
  const auto study = study::study_registration(mission, config.replay, a.study, interrupt.token(),
                                               console.progress_callback());
  if (!study) {
    console.note("interrupted: nothing was written");
    return kInterrupted;
  }
  const study::RegistrationReport report =
      study::report_registration(*study, mission.name, a.study.threads, watch.seconds());
  if (!a.csv.empty()) write_file(a.csv, report.csv);
  if (!a.markdown.empty()) write_file(a.markdown, report.markdown);
  print_json_text(a.common, report.json,
                  std::to_string(study->pairs.size()) + " of " + std::to_string(study->generated) +
                      " candidates\n\n" + report.summary + (a.markdown.empty() ? report.strata : ""));
  return kDone;
}

void add_registration(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<RegistrationArguments>();
  CLI::App* command =
      app.add_subcommand("registration", "Recall, false accepts, errors and times of the registrars");
  command->footer(
      "Candidates of the mission, by proximity of its odometry, drawn uniformly. Overlapping: at the true "
      "pose 40 %\n"
      "of the source's points lie within 0.5 m of the target. Recalled: overlapping, and accepted within 0.5 "
      "m and\n"
      "3 degrees. Wrong: accepted beyond that; false: wrong, and outside the closure's own covariance.\n"
      "  loopwise study registration my_mission --count 500 --csv pairs.csv");
  command->add_option("mission", options->mission, "Mission or session folder with ground truth")
      ->required()
      ->type_name("MISSION");
  add_truth_option(*command, options->truth);
  command->add_option("--registrar", options->registrar, "fast, pcl or both (default both)")
      ->type_name("WORD");
  command->add_option("--count", options->study.count, "Candidates to draw; 0 takes all (default 2000)")
      ->type_name("N")
      ->check(not_negative());
  command
      ->add_option("--pcl-count", options->study.pcl_count, "PCL computes only the first N of them; 0: all")
      ->type_name("N")
      ->check(not_negative());
  command->add_option("--preset", options->preset, "How candidates are found (default lamp_base)")
      ->type_name("NAME");
  command->add_flag("--no-guess", options->no_guess,
                    "The registrars do not get the odometry's relative pose");
  command->add_option("--seed", options->study.seed, "Seed of the draw (default 1)")
      ->type_name("S")
      ->check(not_negative());
  command->add_option("--csv", options->csv, "Write a row for every pair and registrar")
      ->type_name("FILE")
      ->check(not_standard_output());
  command->add_option("--markdown", options->markdown, "Write the tables as Markdown")
      ->type_name("FILE")
      ->check(not_standard_output());
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

struct AcceptanceArguments {
  CommonOptions common;
  ReplayArguments replay;
  std::vector<std::string> missions;
  std::string output;
};

int run(const AcceptanceArguments& a) {
  Console console(a.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(a.common, study::study_config());
  apply(a.replay, config);
  validate_config(config);
  ReplayHooks hooks;
  hooks.progress = console.progress_callback();
  hooks.stop = interrupt.token();
  std::shared_ptr<OutcomeStore> store;
  if (!a.replay.outcomes.empty()) {
    store = std::make_shared<OutcomeStore>(a.replay.outcomes, a.replay.outcomes_bound);
  }
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

void add_acceptance(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<AcceptanceArguments>();
  CLI::App* command =
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
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace

void add_registration_studies(CLI::App& app, Action& chosen) {
  add_registration(app, chosen);
  add_acceptance(app, chosen);
}

}  // namespace loopwise::cli
