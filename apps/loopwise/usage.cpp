// SPDX-License-Identifier: BSD-3-Clause
#include "usage.hpp"

#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/names.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/replay/config.hpp>
#ifdef LOOPWISE_HAS_SIMULATION
#include <loopwise/simulation/simulate.hpp>
#endif

#include "common/action.hpp"

namespace loopwise::cli {
namespace {

template <class E>
std::vector<std::string> words_of() {
  std::vector<std::string> words;
  for (const auto& [enumerator, word] : enum_names(E{})) words.emplace_back(word);
  return words;
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
      throw_unknown_name("option", word, known);
    } catch (const OptionError& unknown) {
      return unknown.what();
    }
  }
  return error.what();
}

/// \throws OptionError if the first word is not a command
void require_command(const CLI::App& app, int argc, char** argv) {
  std::vector<std::string> commands;  // without hidden ones
  bool known = argc < 2 || argv[1][0] == '-' || std::string(argv[1]) == "help";
  for (const CLI::App* command : app.get_subcommands({})) {
    if (!command->get_group().empty()) commands.push_back(command->get_name());
    known = known || command->get_name() == argv[1];
  }
  if (!known) throw_unknown_name("command", argv[1], commands);
}

}  // namespace

std::optional<int> parse(Command& program, int argc, char** argv, bool first) {
  CLI::App& app = program.parser();
  try {
    require_command(app, argc, argv);
  } catch (const OptionError& error) {
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

}  // namespace loopwise::cli
