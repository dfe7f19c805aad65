// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Functions for all subcommands. Each subcommand has one file with one function that adds it to the command
/// line. Its action returns the exit status: 0 done, 1 failed, 2 bad usage, 3 bad input, 130 interrupted.
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
  std::string json;  ///< File for the results as JSON; "-" is standard output.
  std::string config;
  std::vector<std::string> set;
  std::vector<std::string> reading;  ///< As `set`, from add_key_frame_options(); applied last.
  int threads = 0;
  bool strict = false;
  bool quiet = false;
};

/// A chosen subcommand.
using Action = std::function<int()>;

/// Adds the options of CommonOptions to a subcommand.
void add_common_options(CLI::App& command, CommonOptions& options);

/// Adds the options for making key frames from odometry and sweeps, to a subcommand that reads missions.
void add_key_frame_options(CLI::App& command, CommonOptions& options);

/// Adds the options for joining several sources to one mission.
void add_joining_options(CLI::App& command, std::string& frames, bool& start_together);

/// Adds --odometry.
void add_odometry_option(CLI::App& command, std::string& odometry);
/// Adds --decisions.
void add_decisions_option(CLI::App& command, std::string& decisions);
/// Writes the value of --odometry to the configuration, if it was given.
void set_odometry(const std::string& odometry, Config& config);

/// Adds --truth, for set_truth().
void add_truth_option(CLI::App& command, std::vector<std::string>& truth);
/// The files of --truth for one of several missions: all of them if it is the only mission, otherwise the
/// file with the same index. \throws OptionError unless several missions have no file or one each
[[nodiscard]] std::vector<std::string> truth_of_mission(const std::vector<std::string>& truth,
                                                        std::size_t mission, std::size_t missions);

/// Adds the option for the fields of a point in .bin files.
void add_bin_layout_option(CLI::App& command, std::string& layout);
/// Writes the value of that option to the configuration, if it was given. \throws OptionError
void apply_bin_layout(const std::string& layout, Config& config);

/// Check of an option for a whole number. Without it, a negative number would wrap round, and one that is too
/// large would become the largest.
[[nodiscard]] CLI::Validator not_negative();
/// Check of an option that names a file or folder to write. It refuses "-", because results go to standard
/// output.
[[nodiscard]] CLI::Validator not_standard_output();

/// Defaults, then the file of --config, then --set. \throws OptionError, IoError, ParseError
[[nodiscard]] Config load_config(const CommonOptions& options, const Config& defaults = {});

/// The requested number of threads; 0 means one per processor.
[[nodiscard]] int thread_count(const CommonOptions& options);

/// Whether a path names a recording of any kind, instead of a single file of poses or of a graph.
[[nodiscard]] bool is_recording(const std::filesystem::path& path);
/// The graph that `loopwise replay` wrote to this folder; empty if there is no such graph.
[[nodiscard]] std::filesystem::path graph_of_run(const std::filesystem::path& folder);

/// Throws an OptionError if results in this folder could overwrite recorded files: if it is one of the
/// sources, contains one of them, or contains any recording.
void refuse_recording(const std::filesystem::path& folder, const std::vector<std::string>& sources);

/// Writes the results as JSON to the file of --json, and `text` to standard output unless the JSON goes
/// there.
void print_results(const CommonOptions& options, const Json& json, const std::string& text);
/// The same for JSON that is already text, including its last line break.
void print_json_text(const CommonOptions& options, const std::string& json, const std::string& text);

/// Runs an action. Reports an exception as a line on standard error and an exit status.
[[nodiscard]] int run_action(const Action& action, const std::string& program = "loopwise");

/// The body of main(): runs a program, and reports any exception as a line on standard error and an exit
/// status. It also reports allocation failures that no catch block can reach.
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
/// \param job the ranks of a parallel job that includes this process, or null. Ranks other than the first
/// print nothing.
void add_replay(CLI::App& app, Action& chosen, Transport* job);
void add_report(CLI::App& app, Action& chosen);
void add_study(CLI::App& app, Action& chosen, Transport* job);
#ifdef LOOPWISE_HAS_SIMULATION
void add_simulate(CLI::App& app, Action& chosen);
#endif

}  // namespace loopwise::cli
