// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/output_folder.hpp>

#include "commands.hpp"
#include "trainer.hpp"

namespace loopwise::training {
namespace {

struct Options {
  CommonOptions common;
  std::string data, output, network, target;
  std::optional<std::int64_t> epochs, patience;
  std::optional<std::uint64_t> seed;
  bool resume = false;
};

FitOptions fit_options(const Options& options) {
  FitOptions fit;
  load_section(options.common, "fit", fit);
  if (!options.network.empty()) fit.network = parse_enum<NetworkKind>("network", options.network);
  if (!options.target.empty()) fit.target = parse_enum<Target>("target", options.target);
  if (options.epochs) fit.epochs = *options.epochs;
  if (options.patience) fit.patience = *options.patience;
  if (options.seed) fit.seed = *options.seed;
  validate(fit);
  if (fit.network == NetworkKind::kLoopwise && fit.target == Target::kTrace) {
    throw OptionError("target = trace is for the paper's network");
  }
  return fit;
}

/// The epoch with the best validation; empty before the first.
EpochResult best_of(const Trainer& trainer) {
  EpochResult best;
  for (const EpochResult& epoch : trainer.history()) {
    if (epoch.best) best = epoch;
  }
  return best;
}

/// Writes weights.json and history.csv with the present state.
void write_results(const std::filesystem::path& folder, const Trainer& trainer, const FitOptions& fit,
                   const DataOptions& data, const Json& missions) {
  CsvText csv({"epoch", "training_loss", "validation_loss", "best"});
  for (const EpochResult& epoch : trainer.history()) {
    csv.row(epoch.epoch, epoch.training_loss, epoch.validation_loss, epoch.best ? 1 : 0);
  }
  const EpochResult best = best_of(trainer);
  const Json meta = {{"source", "loopwise-train fit"},
                     {"options", to_json(fit)},
                     {"data", to_json(data)},
                     {"missions", missions},
                     {"epochs", trainer.history().size()},
                     {"best_epoch", best.epoch},
                     {"validation_loss", best.validation_loss}};
  write_weights(folder / "weights.json", fit.network, trainer.weights(), meta.dump());
  write_file(folder / "history.csv", csv.text());
}

int run(const Options& options) {
  cli::Console console(options.common.quiet);
  const cli::InterruptGuard interrupt;
  const FitOptions fit = fit_options(options);
  const DataSet data = read_data_set(options.data);
  const std::vector<Role> roles = split_by_mission(data.entries, fit.split_seed);
  std::vector<MissionData> training, validation;
  Json missions = {{"train", Json::array()}, {"validation", Json::array()}};
  for (std::size_t i = 0; i < roles.size(); ++i) {
    if (roles[i] == Role::kTest) continue;
    (roles[i] == Role::kTrain ? training : validation).push_back(data.read(i));
    missions[enum_name(roles[i])].push_back(data.entries[i].name);
    console.progress({"reading", i + 1, roles.size(), ""});
  }
  const std::filesystem::path folder = options.output;
  prepare_output_folder(folder, options.resume, "; --resume continues an interrupted training");
  const std::filesystem::path checkpoint = folder / "checkpoint.cbor";
  if (options.resume && !std::filesystem::exists(checkpoint) &&
      std::filesystem::exists(folder / "weights.json"))
    throw OptionError(folder.string() +
                      ": weights without checkpoint.cbor; their training cannot be continued");
  Trainer trainer(training, validation, fit);
  if (options.resume && std::filesystem::exists(checkpoint)) trainer.load(checkpoint);
  while (!trainer.done()) {
    const auto epoch = trainer.run_epoch(interrupt.token(), console.progress_callback());
    if (!epoch) {
      console.warn("interrupted: " + std::to_string(trainer.history().size()) +
                   " epochs are kept, --resume continues");
      return cli::kInterrupted;
    }
    trainer.save(checkpoint);
    write_results(folder, trainer, fit, data.options, missions);
    char text[160];
    std::snprintf(text, sizeof text, "epoch %3lld  training %.6f  validation %.6f%s",
                  static_cast<long long>(epoch->epoch), epoch->training_loss, epoch->validation_loss,
                  epoch->best ? "  best" : "");
    console.note(text);
  }
  write_results(folder, trainer, fit, data.options, missions);
  const double best = best_of(trainer).validation_loss;
  const Json json = {{"weights", (folder / "weights.json").string()},
                     {"network", enum_name(fit.network)},
                     {"epochs", trainer.history().size()},
                     {"validation_loss", best},
                     {"missions", missions}};
  cli::print_results(options.common, json,
                     (folder / "weights.json").string() + ": " + std::to_string(trainer.history().size()) +
                         " epochs, best validation loss " + fixed(best, 6) + "\n");
  return cli::kDone;
}

}  // namespace

void add_fit(cli::Command& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  cli::Command* command = app.add_subcommand("fit", "Train a network; the result is a weights file");
  command->footer(
      "Writes weights.json (of the epoch with the best validation), history.csv and checkpoint.cbor after "
      "each "
      "epoch.\n"
      "  loopwise-train fit data -o run\n"
      "  loopwise-train fit data -o paper --network paper --seed 2\n"
      "Options of --set and --config: section fit, fields network, target, epochs, patience, learning_rate,\n"
      "hidden, channels, kernels, seed, split_seed.");
  command->add_option("data", options->data, "Folder that 'loopwise-train data' made")
      ->required()
      ->type_name("DATA");
  command->add_option("-o,--output", options->output, "Folder for the results: a new one, or empty")
      ->required()
      ->type_name("DIR")
      ->check(cli::not_standard_output());
  command->add_option("--network", options->network, "loopwise (default) or paper")->type_name("WORD");
  command->add_option("--target", options->target, "Network paper: log (default) or trace")
      ->type_name("WORD");
  command->add_option("--epochs", options->epochs, "Bound on epochs (default 40)")->type_name("N");
  command->add_option("--patience", options->patience, "Epochs without a better validation (default 10)")
      ->type_name("N");
  cli::add_seed_option(*command, options->seed);
  command->add_flag("--resume", options->resume, "Continue an interrupted training");
  cli::finish_command(*command, options, run, chosen);
}

}  // namespace loopwise::training
