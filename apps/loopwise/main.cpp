// SPDX-License-Identifier: BSD-3-Clause
#include "command.hpp"

int main(int argc, char** argv) {
  using namespace loopwise::cli;
  CLI::App app{
      "Decides which loop closures of a multi-robot lidar SLAM system are worth computing, computes them,\n"
      "and keeps the map consistent.",
      "loopwise"};
  app.set_version_flag("--version", std::string("loopwise ") + LOOPWISE_VERSION);
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);
  app.footer(
      "Examples:\n"
      "  loopwise info my_mission                               what is recorded there\n"
      "  loopwise convert my_bags -o my_mission                 recordings of other programs\n"
      "  loopwise replay my_mission -o out --method obs         find loop closures and the map\n"
      "  loopwise report out -o report.html                     look at it in a browser\n"
      "  loopwise optimize graph.g2o -o better.g2o --gnc        optimise a pose graph robustly\n"
      "  loopwise register a.pcd b.pcd                          align two scans\n"
      "  loopwise evaluate estimate.tum truth.tum               trajectory errors\n\n"
      "Exit status: 0 done, 2 bad usage, 3 bad input, 130 interrupted, 1 anything else.\n"
      "Results go to standard output, everything else to standard error.");

  Action chosen;
  add_info(app, chosen);
  add_convert(app, chosen);
  add_replay(app, chosen);
  add_optimize(app, chosen);
  add_rank(app, chosen);
  add_register(app, chosen);
  add_evaluate(app, chosen);
  add_report(app, chosen);
#ifdef LOOPWISE_HAS_SIMULATION
  add_simulate(app, chosen);
#endif
  add_study(app, chosen);
  add_config(app, chosen);

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kBadUsage;
  }
  return run_action(chosen);
}
