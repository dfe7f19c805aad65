// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Functions for all subcommands. Each subcommand has one file with one function that adds it to the command
/// line; its action returns the exit status: 0 done, 1 failed, 2 bad usage, 3 bad input, 130
/// interrupted.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json_fwd.hpp>

#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/output_folder.hpp>
#include <loopwise/replay/config.hpp>

#include "console.hpp"

namespace loopwise {
class Transport;
}

namespace loopwise::cli {

enum ExitStatus : int { kDone = 0, kFailed = 1, kBadUsage = 2, kBadInput = 3, kInterrupted = 130 };

/// Options that every subcommand takes.
struct CommonOptions {
  std::string json;  ///< Where the results go as JSON; "-" is standard output.
  std::string config;
  std::vector<std::string> set;
  std::vector<std::string> reading;  ///< Assignments as of `set`, by add_key_frame_options(); they come last.
  int threads = 0;
  bool strict = false;
  bool quiet = false;
};

/// A chosen subcommand.
using Action = std::function<int()>;

/// Adds the options of CommonOptions to a subcommand.
void add_common_options(CLI::App& command, CommonOptions& options);

/// Adds what says how odometry and sweeps become key frames, to a subcommand that reads missions.
void add_key_frame_options(CLI::App& command, CommonOptions& options);

/// Adds what says how several sources become one mission.
void add_joining_options(CLI::App& command, std::string& frames, bool& start_together);

/// Adds --odometry.
void add_odometry_option(CLI::App& command, std::string& odometry);
/// Adds --decisions.
void add_decisions_option(CLI::App& command, std::string& decisions);
/// Takes over what --odometry says, if it was given.
void set_odometry(const std::string& odometry, Config& config);

/// Adds --truth, for set_truth().
void add_truth_option(CLI::App& command, std::vector<std::string>& truth);
/// The files of --truth for one of several missions: all of them if it is the only one, else the one in its
/// place. \throws OptionError unless several missions have no file or one each
[[nodiscard]] std::vector<std::string> truth_of_mission(const std::vector<std::string>& truth,
                                                        std::size_t mission, std::size_t missions);

/// Adds the option that says what a point is made of in .bin files.
void add_bin_layout_option(CLI::App& command, std::string& layout);
/// Puts the word of that option into the configuration, if there is one. \throws OptionError
void apply_bin_layout(const std::string& layout, Config& config);

/// Check of an option that takes a whole number, which would wrap round below zero or end at the largest.
[[nodiscard]] CLI::Validator not_negative();
/// Check of an option that names a file or folder to write: "-" is refused, as standard output gets the
/// results.
[[nodiscard]] CLI::Validator not_standard_output();

/// Defaults, then the file of --config, then --set. \throws OptionError, IoError, ParseError
[[nodiscard]] Config load_config(const CommonOptions& options, const Config& defaults = {});

/// Number of threads asked for; all processors if 0.
[[nodiscard]] int thread_count(const CommonOptions& options);

/// Whether a path names a recording of any kind, rather than one file of poses or of a graph.
[[nodiscard]] bool is_recording(const std::filesystem::path& path);
/// The graph that `loopwise replay` left in this folder; empty if it is not such a folder.
[[nodiscard]] std::filesystem::path graph_of_run(const std::filesystem::path& folder);

/// Throws an OptionError if results in this folder could take the place of recorded files: if it is one of
/// the sources or holds one of them, or holds any recording.
void refuse_recording(const std::filesystem::path& folder, const std::vector<std::string>& sources);

/// Writes the results as JSON where --json says, and `text` for people to standard output unless the JSON
/// goes there.
void print_results(const CommonOptions& options, const Json& json, const std::string& text);
/// The same of JSON that is text already, with its last line break.
void print_json_text(const CommonOptions& options, const std::string& json, const std::string& text);

/// Runs an action and turns what it throws into a line on standard error and an exit status.
[[nodiscard]] int run_action(const Action& action, const std::string& program = "loopwise");

/// All that main() does: runs a program, and turns what leaves it into a line on standard error and an exit
/// status; also a lack of memory where nothing can be caught.
[[nodiscard]] int run_main(const char* name, int (*program)(int argc, char** argv), int argc,
                           char** argv) noexcept;

void add_align(CLI::App& app, Action& chosen);
void add_config(CLI::App& app, Action& chosen);
void add_convert(CLI::App& app, Action& chosen);
void add_evaluate(CLI::App& app, Action& chosen);
void add_info(CLI::App& app, Action& chosen);
void add_optimize(CLI::App& app, Action& chosen);
void add_rank(CLI::App& app, Action& chosen);
void add_register(CLI::App& app, Action& chosen);
/// `job`: the ranks that this process is one of, or null if it is alone. Ranks but the first print nothing.
void add_replay(CLI::App& app, Action& chosen, Transport* job);
void add_report(CLI::App& app, Action& chosen);
void add_study(CLI::App& app, Action& chosen, Transport* job);
#ifdef LOOPWISE_HAS_SIMULATION
void add_simulate(CLI::App& app, Action& chosen);
#endif

}  // namespace loopwise::cli
