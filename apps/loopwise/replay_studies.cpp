// SPDX-License-Identifier: BSD-3-Clause
// The studies that replay missions: ablation, budget and rssi.
#include "study_arguments.hpp"

namespace loopwise::cli {
namespace {

template <class Study>
struct ReplayStudiesCommand {
  StudyArguments arguments;
  Study study;
};

void add_methods(Command& command, std::vector<std::string>& methods, const std::string& meaning) {
  command.add_option("--methods", methods, meaning)
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("LIST");
}

void add_workers(Command& command, std::optional<std::int64_t>& workers) {
  command.add_option("--workers", workers, "Registrations at a time on the mission's clock (default 10)")
      ->type_name("N");
}

void add_ablation(Command& app, Action& chosen, Transport* job) {
  const auto options = std::make_shared<ReplayStudiesCommand<study::AblationOptions>>();
  options->arguments.job = job;
  Command* command =
      app.add_subcommand("ablation", "Methods side by side over missions and seeds: the paper's Table I");
  command->footer(
      "Missions of one world are its repetitions. Every finished run is kept: the same command continues "
      "where it\n"
      "was ended, and computes nothing twice.\n"
      "  loopwise study ablation tunnel-* urban-* -o ablation --methods baseline,obs,random,gi,full\n"
      "DIR gets runs.csv, ablation.json, ablation.md and ablation_timings.csv.");
  add_methods(*command, options->study.methods, "Methods, by commas (default baseline,obs,random,gi,full)");
  add_workers(*command, options->study.workers);
  command->add_flag("--map-quality", options->study.map_quality,
                    "Also judge each map at revisits that it was not made of, as evaluate --map does");
  add_study_arguments(*command, options->arguments);
  command->callback([options, &chosen] {
    chosen = [options] {
      return run_study(options->arguments, "ablation", "runs.csv", [&](const auto& of, const auto& hooks) {
        return study::ablation(of, options->study, hooks);
      });
    };
  });
}

void add_budget(Command& app, Action& chosen, Transport* job) {
  const auto options = std::make_shared<ReplayStudiesCommand<study::BudgetOptions>>();
  options->arguments.job = job;
  Command* command = app.add_subcommand(
      "budget", "Errors against computation: computers, mission time, everything computed");
  command->footer(
      "  loopwise study budget tunnel-* -o budget --workers 2,10,50\n"
      "  loopwise study budget mine-* -o budget --thin 20      everything computed: one candidate in 20\n"
      "DIR gets curves.csv, budget.json, budget.md and budget_timings.csv. Runs are kept as by 'study "
      "ablation', and\n"
      "shared with it if DIR is the same.");
  add_methods(*command, options->study.methods, "Methods, by commas (default baseline,full)");
  command
      ->add_option("--workers", options->study.workers,
                   "Computers, by their registrations at a time, by commas (default 2,10,50)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("LIST");
  command
      ->add_option(
          "--everything", options->study.everything,
          "Method in whose order everything is computed after the mission, or none (default baseline)")
      ->type_name("M");
  add_study_arguments(*command, options->arguments);
  command->callback([options, &chosen] {
    chosen = [options] {
      return run_study(options->arguments, "budget", "curves.csv", [&](const auto& of, const auto& hooks) {
        return study::budget(of, options->study, hooks);
      });
    };
  });
}

void add_rssi(Command& app, Action& chosen, Transport* job) {
  const auto options = std::make_shared<ReplayStudiesCommand<study::RssiOptions>>();
  options->arguments.job = job;
  Command* command =
      app.add_subcommand("rssi", "Errors of each robot with closures at radio beacons: the paper's Table II");
  command->footer(
      "  loopwise study rssi finals-* -o rssi\n"
      "DIR gets robots.csv, rssi.json, rssi.md and rssi_timings.csv. Runs are kept as by 'study ablation', "
      "and shared\n"
      "with it if DIR is the same.");
  add_methods(*command, options->study.methods, "Methods beside odometry, by commas (default rssi,full)");
  add_workers(*command, options->study.workers);
  add_study_arguments(*command, options->arguments);
  command->callback([options, &chosen] {
    chosen = [options] {
      return run_study(options->arguments, "rssi", "robots.csv", [&](const auto& of, const auto& hooks) {
        return study::rssi(of, options->study, hooks);
      });
    };
  });
}

}  // namespace

void add_replay_studies(Command& app, Action& chosen, Transport* job) {
  add_ablation(app, chosen, job);
  add_budget(app, chosen, job);
  add_rssi(app, chosen, job);
}

}  // namespace loopwise::cli
