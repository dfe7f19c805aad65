// SPDX-License-Identifier: BSD-3-Clause
#include "command.hpp"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <new>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/atomic_file.hpp>

namespace loopwise::cli {
namespace {

// For the handlers of the process, which take no arguments.
std::atomic<bool> memory_ran_out{false};
std::atomic<const char*> program_name{"loopwise"};

/// Values of the JSON library ask for memory when they go, and walking a folder does so in functions that
/// must not throw. Where there is none, no catch is reached.
[[noreturn]] void end_at_once() {
  if (memory_ran_out) {
    std::fprintf(stderr, "%s: out of memory\n", program_name.load());
    std::_Exit(kFailed);
  }
  try {
    if (const std::exception_ptr error = std::current_exception()) std::rethrow_exception(error);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", program_name.load(), error.what());
  } catch (...) {
  }
  std::abort();
}

}  // namespace

void add_common_options(CLI::App& command, CommonOptions& options) {
  command.add_option("--json", options.json, "Write the results as JSON to FILE (- for standard output)")
      ->type_name("FILE");
  command.add_option("--config", options.config, "Read options from a JSON file (see 'loopwise config')")
      ->type_name("FILE");
  command
      .add_option("--set", options.set,
                  "Set one option, for example --set generation.radius_max_m=20; may be repeated")
      ->type_name("SECTION.FIELD=VALUE")
      ->expected(1)
      ->take_all();
  command
      .add_option("--threads", options.threads, "Threads; 0 takes all processors. Never changes the results")
      ->type_name("N")
      ->check(CLI::Range(0, 4096));
  command.add_flag("--strict", options.strict,
                   "Input of which a measurement would be repaired, guessed or left out is an error");
  command.add_flag("--quiet", options.quiet, "No progress and no notes; warnings and errors remain");
}

void add_joining_options(CLI::App& command, std::string& frames, bool& start_together) {
  command
      .add_option(
          "--frames", frames,
          "Several missions: pose of each one's frame in the common frame, CSV "
          "(source,x,y,z,qx,qy,qz,qw or source,x,y,z,yaw, with sigmas or without) or TUM; of convert and "
          "replay also auto: found from the scans, or common: as they stand")
      ->type_name("FILE");
  command.add_flag("--start-together", start_together, "Several missions: all begin at the same moment");
}

void add_odometry_option(CLI::App& command, std::string& odometry) {
  command
      .add_option(
          "--odometry", odometry,
          "Which edges are odometry: a file with two keys a line, or the word consecutive: those between "
          "neighbours of a robot (default)")
      ->type_name("FILE");
}

void set_odometry(const std::string& odometry, Config& config) {
  if (odometry.empty()) return;
  config.mission.odometry = odometry == "consecutive" ? std::string() : odometry;
}

void add_truth_option(CLI::App& command, std::vector<std::string>& truth) {
  command
      .add_option(
          "--truth", truth,
          "True poses of the nodes, TUM, KITTI or g2o, in place of recorded ones; of several robots, a "
          "file each; may be repeated")
      ->type_name("[ROBOT=]FILE")
      ->expected(1)
      ->take_all();
}

std::vector<std::string> truth_of_mission(const std::vector<std::string>& truth, std::size_t mission,
                                          std::size_t missions) {
  if (truth.empty() || missions == 1) return truth;
  if (truth.size() != missions) {
    throw OptionError("--truth is given " + std::to_string(truth.size()) + " times for " +
                      std::to_string(missions) + " missions: give one file for each, in their order");
  }
  return {truth[mission]};
}

void require_truth(const std::string& path, const Mission& mission) {
  if (!mission.ground_truth.empty()) return;
  throw InputError(
      path + ": has no ground truth to compare with" +
      (mission.reference.empty() ? "" : " (its own optimised poses are another program's result)") +
      "; --truth FILE says what is true");
}

void add_bin_layout_option(CLI::App& command, std::string& layout) {
  command
      .add_option("--bin-layout", layout,
                  "Points of .bin files: auto (default), xyz, xyzi, xyzir, xyzirt, xyz_double, xyzi_double, "
                  "helipr_ouster, helipr_velodyne, helipr_avia, helipr_aeva or helipr_aeva_intensity")
      ->type_name("WORD");
}

void apply_bin_layout(const std::string& layout, Config& config) {
  if (!layout.empty()) config.mission.bin_layout = parse_enum<BinLayout>("--bin-layout", layout);
}

CLI::Validator not_negative() {
  return CLI::Validator(
      [](std::string& text) -> std::string {
        std::uint64_t value = 0;
        const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
        if (!text.empty() && text.front() == '-') return text + " is negative, must be >= 0";
        if (parsed.ec == std::errc::result_out_of_range) return text + " exceeds 64 bits";
        return {};
      },
      "");
}

CLI::Validator not_standard_output() {
  return CLI::Validator(
      [](std::string& path) -> std::string {
        if (path != "-") return {};
        return "\"-\" is standard output, which gets the results: give a name (./- for one of that name; "
               "--json - "
               "prints the results as JSON)";
      },
      "");
}

Config load_config(const CommonOptions& options, const Config& defaults) {
  Config config = defaults;
  if (!options.config.empty()) read_config(options.config, config);
  for (const std::string& assignment : options.set) set_config_option(assignment, config);
  if (options.strict) config.mission.strict = true;
  validate_config(config);
  return config;
}

int thread_count(const CommonOptions& options) {
  return resolve_threads(options.threads);
}

bool is_recording(const std::filesystem::path& path) {
  const std::filesystem::path ending = path.extension();
  return std::filesystem::is_directory(path) || ending == ".bag" || ending == ".zip" || ending == ".json";
}

std::filesystem::path graph_of_run(const std::filesystem::path& folder) {
  const std::filesystem::path graph = folder / "graph.g2o";
  return std::filesystem::exists(folder / "summary.json") && std::filesystem::exists(graph)
             ? graph
             : std::filesystem::path();
}

void prepare_output_folder(const std::filesystem::path& folder, bool may_exist, const std::string& hint) {
  namespace fs = std::filesystem;
  if (folder.empty()) throw OptionError("the output folder has no name");
  if (fs::exists(folder) && !fs::is_directory(folder)) {
    throw OptionError(folder.string() + ": exists and is not a folder");
  }
  if (fs::exists(folder) && !fs::is_empty(folder) && !may_exist) {
    throw OptionError(folder.string() + ": exists and is not empty" + hint);
  }
  std::error_code failure;
  fs::create_directories(folder, failure);
  if (failure) throw std::runtime_error(folder.string() + ": " + failure.message());
  if (access(folder.c_str(), W_OK | X_OK) != 0) throw std::runtime_error(folder.string() + ": not writable");
}

void refuse_recording(const std::filesystem::path& folder, const std::vector<std::string>& sources) {
  namespace fs = std::filesystem;
  if (!fs::is_directory(folder)) return;
  const std::string consequence = ", whose files the results could replace: choose another folder";
  std::error_code unknown;
  for (const fs::path source : sources) {
    const fs::path place = fs::is_directory(source) ? source : fs::absolute(source).parent_path();
    if (fs::equivalent(place, folder, unknown))
      throw OptionError(folder.string() + ": " + source.string() + " lies there" + consequence);
  }
  for (const char* name : {"mission.json", "result.g2o", "keys.csv", "optimized_poses.txt", "odom_poses.txt",
                           "singlesession_posegraph.g2o"}) {
    if (fs::exists(folder / name))
      throw OptionError(folder.string() + ": there is a recording (" + name + ")" + consequence);
  }
}

void print_results(const CommonOptions& options, const Json& json, const std::string& text) {
  const bool to_output = options.json == "-";
  if (!options.json.empty() && !to_output) write_file(options.json, json_text(json, 2) + "\n");
  std::cout << (to_output ? json_text(json, 2) + "\n" : text) << std::flush;
  if (!std::cout) throw IoError("standard output", "cannot be written");
}

int run_action(const Action& action, const std::string& program) {
  const auto complain = [&program](const std::exception& error) {
    std::cerr << program << ": " << error.what() << "\n";
  };
  try {
    return action();
  } catch (const OptionError& error) {
    complain(error);
    return kBadUsage;
  } catch (const InputError& error) {
    complain(error);
    return kBadInput;
  } catch (const IoError& error) {
    complain(error);
    return kBadInput;
  } catch (const StoppedError& error) {
    complain(error);
    return kInterrupted;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", program.c_str());  // takes none
    return kFailed;
  } catch (const std::exception& error) {
    complain(error);
    return kFailed;
  }
}

int run_main(const char* name, int (*program)(int argc, char** argv), int argc, char** argv) noexcept {
  program_name = name;
  std::set_terminate(end_at_once);
  std::set_new_handler([] {
    memory_ran_out = true;
    throw std::bad_alloc();
  });
  // What a command throws ends in run_action(); this is for what comes before it.
  try {
    return program(argc, argv);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", name);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", name, error.what());
  }
  return kFailed;
}

std::string fixed(double value, int decimals) {
  if (std::isnan(value)) return "-";
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", decimals, value);
  return text;
}

std::string table(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths;
  for (const auto& row : rows) {
    widths.resize(std::max(widths.size(), row.size()), 0);
    for (std::size_t c = 0; c < row.size(); ++c) widths[c] = std::max(widths[c], row[c].size());
  }
  std::string out;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    std::string line;
    for (std::size_t c = 0; c < rows[r].size(); ++c) {
      const std::string gap(widths[c] - rows[r][c].size(), ' ');
      line += c == 0 ? rows[r][c] + gap : "  " + gap + rows[r][c];
    }
    out += line + "\n";
    if (r == 0) out += std::string(line.size(), '-') + "\n";
  }
  return out;
}

}  // namespace loopwise::cli
