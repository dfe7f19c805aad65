// SPDX-License-Identifier: BSD-3-Clause
#include <iostream>
#include <optional>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/core/version.hpp>
#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/mpi_session.hpp>
#endif

#include "command.hpp"
#include "common/reference.hpp"
#include "usage.hpp"

namespace {

bool is_first([[maybe_unused]] const loopwise::Transport& job) {
#ifdef LOOPWISE_HAS_MPI
  return job.rank() == 0;
#else
  return true;
#endif
}

void describe(loopwise::cli::Command& app) {
  app.set_version_flag("--version", "loopwise " + std::string(loopwise::version()));
  app.require_subcommand();
  app.footer(
      "Examples:\n"
      "  loopwise info my_mission                               contents of a recording\n"
      "  loopwise convert my_bags -o my_mission                 recordings of other programs\n"
      "  loopwise align my_map new_session -o joined            place a session in a map\n"
      "  loopwise replay my_mission -o out --method obs         find loop closures and the map\n"
      "  loopwise report out -o report.html                     look at it in a browser\n"
      "  loopwise optimize graph.g2o -o better.g2o --gnc        optimise a pose graph robustly\n"
      "  loopwise register a.pcd b.pcd                          align two scans\n"
      "  loopwise evaluate estimate.tum truth.tum               trajectory errors\n\n"
      "Exit status: 0 done, 2 bad usage, 3 bad input, 130 interrupted, 1 anything else.\n"
      "Results go to standard output, everything else to standard error.");
}

void add_commands(loopwise::cli::Command& app, loopwise::cli::Action& chosen, loopwise::Transport* job) {
  using namespace loopwise::cli;
  add_info(app, chosen);
  add_convert(app, chosen);
  add_align(app, chosen);
  add_replay(app, chosen, job);
  add_optimize(app, chosen);
  add_rank(app, chosen);
  add_register(app, chosen);
  add_evaluate(app, chosen);
  add_report(app, chosen);
#ifdef LOOPWISE_HAS_SIMULATION
  add_simulate(app, chosen);
#endif
  add_study(app, chosen, job);
  add_config(app, chosen);
  add_reference(app, chosen, value_words());
}

int run_program(int argc, char** argv) {
  using namespace loopwise;
  using namespace loopwise::cli;
  Command app{
      "Decides which loop closures of a multi-robot lidar SLAM system are worth computing, computes them,\n"
      "and keeps the map consistent.",
      "loopwise"};
  describe(app);
  Transport* job = nullptr;
#ifdef LOOPWISE_HAS_MPI
  std::optional<MpiSession> session;
  if (started_by_mpi()) {
    try {
      session.emplace();
    } catch (const Error& error) {
      std::cerr << "loopwise: " << error.what() << "\n";
      return kFailed;
    }
    if (session->transport().size() > 1) job = &session->transport();
  }
#endif
  Action chosen;
  add_commands(app, chosen, job);
  const bool first = job == nullptr || is_first(*job);
  if (const auto status = parse(app, argc, argv, first)) return *status;
  if (job != nullptr && !app.got_subcommand("replay") && !app.got_subcommand("study")) {
    if (first) std::cerr << "loopwise: only replay and study can use several ranks\n";
    return kBadUsage;
  }
  const int status = run_action(chosen);
#ifdef LOOPWISE_HAS_MPI
  // The other ranks wait for this one, or one of them hangs, so they cannot end on their own.
  if (job != nullptr && status != kDone && status != kInterrupted) session->abort(status);
#endif
  return status;
}

}  // namespace

int main(int argc, char** argv) {
  return loopwise::cli::run_main("loopwise", run_program, argc, argv);
}
