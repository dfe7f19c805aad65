// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/version.hpp>

#include "commands.hpp"
#include "common/reference.hpp"

namespace {

int run_program(int argc, char** argv) {
  using namespace loopwise;
  cli::Command app{
      "Trains the networks that predict the uncertainty of a pose graph with a set of loop closures, "
      "and\ncompares them with exact values.",
      "loopwise-train"};
  app.set_version_flag("--version", "loopwise-train " + std::string(version()));
  app.require_subcommand();
  app.footer(
      "Examples:\n"
      "  loopwise-train data -o data                            simulate missions, solve sets exactly\n"
      "  loopwise-train fit data -o run                         train; run/weights.json is the network\n"
      "  loopwise-train evaluate data run/weights.json          on missions never trained on\n\n"
      "Exit status: 0 done, 2 bad usage, 3 bad input, 130 interrupted, 1 anything else.\n"
      "Results go to standard output, everything else to standard error.");
  cli::Action chosen;
  training::add_data(app, chosen);
  training::add_fit(app, chosen);
  training::add_evaluate(app, chosen);
  cli::add_reference(app, chosen, {});
  if (const auto status = app.parse(argc, argv)) return *status == 0 ? cli::kDone : cli::kBadUsage;
  return cli::run_action(chosen, "loopwise-train");
}

}  // namespace

int main(int argc, char** argv) {
  return loopwise::cli::run_main("loopwise-train", run_program, argc, argv);
}
