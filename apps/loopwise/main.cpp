// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <iostream>
#include <optional>
#include <sstream>

#include <loopwise/core/error.hpp>
#include <loopwise/core/version.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/optimization/optimizer.hpp>
#ifdef LOOPWISE_HAS_SIMULATION
#include <loopwise/simulation/simulate.hpp>
#endif
#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/mpi_session.hpp>
#endif

#include "command.hpp"
#include "reference.hpp"

namespace loopwise::cli {
namespace {

template <class E>
std::vector<std::string> words_of() {
  std::vector<std::string> words;
  for (const auto& [enumerator, word] : enum_names(E{})) words.emplace_back(word);
  return words;
}

/// Possible values of options, for completion.
ValueWords value_words() {
  ValueWords words;
  words["--method"] = words["--methods"] = method_names();
  words["--preset"] = proximity_preset_names();
  words["--registrar"] = words_of<RegistrarKind>();
  words["--guess"] = words_of<GuessSource>();
  words["--initialization"] = words_of<Initialization>();
  words["--alignment"] = words_of<Alignment>();
  words["--clock"] = {"virtual", "real"};
#ifdef LOOPWISE_HAS_SIMULATION
  words["--lidar"] = words_of<LidarKind>();
  words["--scans"] = words_of<ScanKind>();
  words["world"] = words_of<WorldKind>();
#endif
  for (const ConfigEntry& entry : describe_config(Config())) words["--set"].push_back(entry.name + "=");
  return words;
}

}  // namespace
}  // namespace loopwise::cli

namespace {

bool is_first([[maybe_unused]] const loopwise::Transport& job) {
#ifdef LOOPWISE_HAS_MPI
  return job.rank() == 0;
#else
  return true;
#endif
}

/// Error message for an argument that no option takes.
std::string about_extra(const CLI::App& app, int argc, char** argv, const CLI::ExtrasError& error) {
  const CLI::App* command = &app;
  while (!command->get_subcommands().empty()) command = command->get_subcommands().front();
  for (int i = 1; i < argc; ++i) {
    const std::string word = std::string(argv[i]).substr(0, std::string(argv[i]).find('='));
    if (word.rfind("--", 0) != 0 || command->get_option_no_throw(word) != nullptr) continue;
    std::vector<std::string> known;
    for (const CLI::Option* option : command->get_options()) {
      for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
    }
    try {
      loopwise::throw_unknown_name("option", word, known);
    } catch (const loopwise::OptionError& unknown) {
      return unknown.what();
    }
  }
  return error.what();
}

void describe(CLI::App& app) {
  app.set_version_flag("--version", "loopwise " + std::string(loopwise::version()));
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);
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

void add_commands(CLI::App& app, loopwise::cli::Action& chosen, loopwise::Transport* job) {
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

/// \throws OptionError if the first word is not a command
void require_command(const CLI::App& app, int argc, char** argv) {
  std::vector<std::string> commands;  // without hidden ones
  bool known = argc < 2 || argv[1][0] == '-' || std::string(argv[1]) == "help";
  for (const CLI::App* command : app.get_subcommands({})) {
    if (!command->get_group().empty()) commands.push_back(command->get_name());
    known = known || command->get_name() == argv[1];
  }
  if (!known) loopwise::throw_unknown_name("command", argv[1], commands);
}

/// Parses the command line. \returns the exit status if no command has to run. Only the first rank prints.
std::optional<int> parse(CLI::App& app, int argc, char** argv, bool first) {
  using namespace loopwise::cli;
  try {
    require_command(app, argc, argv);
  } catch (const loopwise::OptionError& error) {
    if (first) std::cerr << "loopwise: " << error.what() << "\n";
    return kBadUsage;
  }
  // `loopwise help replay` means `loopwise replay --help`.
  std::vector<char*> arguments(argv, argv + argc);
  char help[] = "--help";
  if (argc > 1 && std::string(argv[1]) == "help") {
    arguments.erase(arguments.begin() + 1);
    arguments.push_back(help);
  }
  argc = static_cast<int>(arguments.size());
  try {
    app.parse(argc, arguments.data());
  } catch (const CLI::ExtrasError& error) {
    if (first) std::cerr << "loopwise: " << about_extra(app, argc, arguments.data(), error) << "\n";
    return kBadUsage;
  } catch (const CLI::ParseError& error) {
    std::ostringstream nowhere;
    const int code = first ? app.exit(error) : app.exit(error, nowhere, nowhere);
    return code == 0 ? kDone : kBadUsage;
  }
  return std::nullopt;
}

int run_program(int argc, char** argv) {
  using namespace loopwise;
  using namespace loopwise::cli;
  CLI::App app{
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
