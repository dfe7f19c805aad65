// SPDX-License-Identifier: BSD-3-Clause
// The chances of method expected, fitted to missions.
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/acceptance_fit.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/replay/outcome_store.hpp>

#include "replay_arguments.hpp"
#include "study.hpp"
#include "study_tables.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  ReplayArguments replay;
  std::vector<std::string> missions;
  std::string output;
};

/// One of the two models, in the report.
struct Model {
  AcceptanceOutcome outcome;
  const char* title;
  const char* option;
};
constexpr Model kModels[] = {{AcceptanceOutcome::kVerified, "A candidate is verified", "verified_weights"},
                             {AcceptanceOutcome::kRight, "A verified closure is kept", "right_weights"}};

std::string scores_text(const AcceptanceFit& fit) {
  std::vector<std::vector<std::string>> rows{
      {"mission left out", "samples", "positive", "ROC area", "by distance alone", "Brier score"}};
  for (const AcceptanceScore& score : fit.scores) {
    rows.push_back({score.mission, std::to_string(score.count), std::to_string(score.positive),
                    fixed(score.auc, 3), fixed(score.auc_by_distance, 3), fixed(score.brier, 3)});
  }
  if (fit.scores.empty()) return "One mission: nothing to leave out.\n";
  const bool some_unscored =
      std::any_of(fit.scores.begin(), fit.scores.end(),
                  [](const AcceptanceScore& score) { return score.count > 0 && std::isnan(score.brier); });
  return markdown_table(rows) +
         (some_unscored
              ? "\nA mission without a score: the others have no sample of each outcome to fit to.\n"
              : "");
}

std::string reliability_text(const Calibration& calibration) {
  std::vector<std::vector<std::string>> rows{{"chance", "samples", "mean chance", "came true"}};
  for (std::size_t b = 0; b < calibration.bins().size(); ++b) {
    const Calibration::Bin& bin = calibration.bins()[b];
    if (bin.count == 0) continue;
    const auto count = static_cast<double>(bin.count);
    rows.push_back(
        {fixed(0.1 * static_cast<double>(b), 1) + " to " + fixed(0.1 * static_cast<double>(b + 1), 1),
         std::to_string(bin.count), fixed(bin.expected / count, 3),
         fixed(static_cast<double>(bin.verified) / count, 3)});
  }
  return rows.size() > 1 ? "\n" + markdown_table(rows) : std::string();
}

std::string weights_text(const AcceptanceModel::Terms& weights) {
  std::string text;
  for (const double weight : weights) text += (text.empty() ? "" : ",") + fixed(weight, 2);
  return text;
}

Json scores_json(const AcceptanceFit& fit) {
  const auto number = [](double value) { return std::isfinite(value) ? Json(value) : Json(); };
  Json rows = Json::array();
  for (const AcceptanceScore& score : fit.scores) {
    rows.push_back({{"mission", score.mission},
                    {"samples", score.count},
                    {"positive", score.positive},
                    {"auc", number(score.auc)},
                    {"auc_by_distance", number(score.auc_by_distance)},
                    {"brier", number(score.brier)}});
  }
  return rows;
}

/// Samples of all missions, or of those that were done when the user interrupted.
std::vector<AcceptanceSamples> collect(const Options& options, const Config& config, Console& console,
                                       const StopToken& stop) {
  std::shared_ptr<OutcomeStore> store;
  if (!options.replay.outcomes.empty()) {
    store = std::make_shared<OutcomeStore>(options.replay.outcomes, options.replay.outcomes_bound);
  }
  ThreadPool threads(thread_count(options.common));
  std::vector<AcceptanceSamples> missions;
  for (const std::string& path : options.missions) {
    if (stop.stop_requested()) break;
    const Mission mission = read_mission(path, config.mission, console.progress_callback());
    console.warn(mission.problems);
    ReplayHooks hooks;
    hooks.progress = console.progress_callback();
    hooks.stop = stop;
    missions.push_back(collect_acceptance(
        mission, config.replay, make_registration(config.replay.registration, mission.scans->loader(), store),
        threads, hooks));
  }
  return missions;
}

int run(const Options& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config;
  config.replay.engine.guess = GuessSource::kOdometry;
  config = load_config(options.common, config);
  apply(options.replay, config);
  validate_config(config);
  const std::vector<AcceptanceSamples> missions = collect(options, config, console, interrupt.token());
  if (interrupt.interrupted()) {
    console.warn("interrupted: nothing was fitted; registrations in --outcomes are kept");
    return kInterrupted;
  }

  Json json = {{"terms", AcceptanceModel::term_names()}}, weights = Json::object();
  std::string text = "# Chances of candidates\n", failure;
  for (const Model& model : kModels) {
    text += std::string("\n## ") + model.title + "\n\n";
    try {
      const AcceptanceFit fit = fit_acceptance(missions, model.outcome);
      weights[model.option] = weights_text(fit.weights);
      json[model.option] = {{"weights", fit.weights}, {"left_out", scores_json(fit)}};
      text += scores_text(fit) + reliability_text(fit.calibration) + "\nFitted to all: `--set expected." +
              model.option + "=" + weights_text(fit.weights) + "`\n";
    } catch (const InputError& error) {
      failure = error.what();
      json[model.option] = {{"weights", nullptr}, {"reason", failure}};
      text += "Not fitted: " + failure + "\n";
      console.warn(std::string(model.option) + " not fitted: " + failure);
    }
  }
  if (weights.empty()) throw InputError(failure);
  if (!options.output.empty()) write_file(options.output, json_text({{"expected", weights}}, 2) + "\n");
  print_results(options.common, json, text);
  return kDone;
}

}  // namespace

void add_acceptance_study(CLI::App& study, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      study.add_subcommand("acceptance", "Fit the chances of method expected to missions, and judge the fit");
  command->footer(
      "Replays each mission with candidates in random order and fits how likely a candidate is verified, "
      "and\n"
      "a verified closure kept, to what came of them. Scores are of missions that were left out of the fit.\n"
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

}  // namespace loopwise::cli
