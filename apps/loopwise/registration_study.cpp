// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/io/atomic_file.hpp>
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

int run_registration_study(const RegistrationArguments& a) {
  const Stopwatch watch;
  Console console(a.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(a.common);
  if (!a.preset.empty()) config.replay.engine.generation = proximity_preset(a.preset);
  if (a.no_guess) config.replay.engine.task.use_guess = false;
  study::RegistrationStudyOptions options = a.study;
  if (a.registrar != "both") options.registrars = {parse_enum<RegistrarKind>("--registrar", a.registrar)};
  options.threads = thread_count(a.common);
  Mission mission = read_mission(a.mission, config.mission, console.progress_callback(), interrupt.token());
  set_truth(mission, a.truth, config.mission);
  console.warn(mission.problems);
  require_truth(a.mission, mission);
  const auto study = study::study_registration(mission, config.replay, options, interrupt.token(),
                                               console.progress_callback());
  if (!study) {
    console.note("interrupted: nothing was written");
    return kInterrupted;
  }
  const study::RegistrationReport report =
      study::report_registration(*study, mission.name, options.threads, watch.seconds());
  if (!a.csv.empty()) write_file(a.csv, report.csv);
  if (!a.markdown.empty()) write_file(a.markdown, report.markdown);
  print_json_text(a.common, report.json,
                  std::to_string(study->pairs.size()) + " of " + std::to_string(study->generated) +
                      " candidates\n\n" + report.summary + (a.markdown.empty() ? report.strata : ""));
  return kDone;
}

}  // namespace

void add_registration_study(Command& app, Action& chosen) {
  const auto options = std::make_shared<RegistrationArguments>();
  Command* command =
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
  const auto* no_guess = command->add_flag("--no-guess", options->no_guess,
                                           "The registrars do not get the odometry's relative pose");
  command
      ->add_flag("--true-guess", options->study.true_guess,
                 "They get the true relative pose: shows what a better search could gain")
      ->excludes(no_guess);
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
  finish_command(*command, options, run_registration_study, chosen);
}

}  // namespace loopwise::cli
