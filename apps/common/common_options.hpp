// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options that every command takes, and the output of its results.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/config.hpp>

#include "action.hpp"
#include "command_line.hpp"

namespace loopwise::cli {

/// Options that every command takes.
struct CommonOptions {
  std::string json;  ///< File for the results as JSON; "-" is standard output.
  std::string config;
  std::vector<std::string> set;
  std::vector<std::string> reading;  ///< As `set`, from other options; applied last.
  int threads = 0;
  bool strict = false;
  bool quiet = false;
};

/// Adds the options of CommonOptions to a command.
void add_common_options(Command& command, CommonOptions& options);

/// Adds the options of CommonOptions after those of the command, and makes `run` its action. `run` returns
/// the exit status.
template <class Options>
void finish_command(Command& command, const std::shared_ptr<Options>& options, int (*run)(const Options&),
                    Action& chosen) {
  add_common_options(command, options->common);
  command.callback([options, run, &chosen] { chosen = [options, run] { return run(*options); }; });
}

/// Check of an option for a whole number. Without it, a negative number would wrap round, and one that is too
/// large would become the largest.
[[nodiscard]] Check not_negative();
/// Check of an option that names a file or folder to write. It refuses "-", because results go to standard
/// output.
[[nodiscard]] Check not_standard_output();

/// Adds --seed. \param seed a number, or an optional one
template <class Seed>
void add_seed_option(Command& command, Seed& seed) {
  command.add_option("--seed", seed, "Seed of all random draws (default 1)")
      ->type_name("S")
      ->check(not_negative());
}

/// Defaults, then the file of --config, then --set. \throws OptionError, IoError, ParseError
[[nodiscard]] Config load_config(const CommonOptions& options, const Config& defaults = {});

/// The requested number of threads; 0 means one per processor.
[[nodiscard]] int thread_count(const CommonOptions& options);

/// Writes the results as JSON to the file of --json, and `text` to standard output unless the JSON goes
/// there.
void print_results(const CommonOptions& options, const Json& json, const std::string& text);
/// The same for JSON that is already text, including its last line break.
void print_json_text(const CommonOptions& options, const std::string& json, const std::string& text);

}  // namespace loopwise::cli
