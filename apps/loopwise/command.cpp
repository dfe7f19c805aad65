// SPDX-License-Identifier: BSD-3-Clause
#include "command.hpp"

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <new>
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/atomic_file.hpp>

namespace loopwise::cli {
namespace {

// Global, because the process's handlers take no arguments.
std::atomic<bool> memory_ran_out{false};
std::atomic<const char*> program_name{"loopwise"};

/// Terminate handler. Destructors of the JSON library, and noexcept functions that walk folders, allocate
/// memory. If that fails, they call this handler, and no catch block is reached.
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
                   "Input is an error if a measurement would be repaired, guessed or left out");
  command.add_flag("--quiet", options.quiet, "No progress and no notes; warnings and errors remain");
}

void add_key_frame_options(CLI::App& command, CommonOptions& options) {
  const auto assign = [&options](const char* field) {
    return [&options, field](const std::string& value) {
      options.reading.push_back("mission." + std::string(field) + "=" + value);
    };
  };
  command
      .add_option_function<std::string>("--keyframe-distance", assign("keyframe_distance_m"),
                                        "Odometry with sweeps: a key frame after M metres (default 1)")
      ->type_name("M");
  command
      .add_option_function<double>(
          "--keyframe-angle",
          [&options](double degrees) {
            std::ostringstream text;
            text.precision(17);
            text << "mission.keyframe_angle_rad=" << degrees / 57.29577951308232;
            options.reading.push_back(text.str());
          },
          "Odometry with sweeps: a key frame after a turn of DEG degrees (default 20)")
      ->type_name("DEG");
  command
      .add_option_function<std::string>("--submap", assign("submap_sweeps"),
                                        "Odometry with sweeps: join up to N sweeps around a key frame to its "
                                        "scan (default 0: its own sweep only)")
      ->type_name("N");
  command
      .add_option_function<std::string>("--poses", assign("poses"),
                                        "Folders of sweeps: file with their poses, KITTI rows or TUM")
      ->type_name("FILE");
  command
      .add_option_function<std::string>("--odometry-topic", assign("odometry_topic"),
                                        "Bags without graphs: topic of the odometry, whole or within each "
                                        "robot's namespace")
      ->type_name("NAME");
  command
      .add_option_function<std::string>("--cloud-topic", assign("cloud_topic"),
                                        "Bags without graphs: topic of the clouds, in the same way")
      ->type_name("NAME");
  command
      .add_option_function<std::string>("--truth-topic", assign("truth_topic"),
                                        "Bags without graphs: topic of true poses, in the same way")
      ->type_name("NAME");
}

void add_joining_options(CLI::App& command, std::string& frames, bool& start_together) {
  command
      .add_option("--frames", frames,
                  "Several missions: pose of each one's frame in the common frame, CSV "
                  "(source,x,y,z,qx,qy,qz,qw or source,x,y,z,yaw, with sigmas or without) or TUM; for "
                  "convert and replay also auto: found from the scans, or common: poses unchanged")
      ->type_name("FILE");
  command.add_flag("--start-together", start_together, "Several missions: all begin at the same time");
}

void add_odometry_option(CLI::App& command, std::string& odometry) {
  command
      .add_option("--odometry", odometry,
                  "Which edges are odometry: a file with two keys per line, or the word consecutive: those "
                  "between neighbours of a robot (default)")
      ->type_name("FILE");
}

void add_decisions_option(CLI::App& command, std::string& decisions) {
  command
      .add_option("--decisions", decisions,
                  "Closures that a person has accepted or rejected: a file that the report has saved")
      ->type_name("decisions.csv");
}

void set_odometry(const std::string& odometry, Config& config) {
  if (odometry.empty()) return;
  config.mission.odometry = odometry == "consecutive" ? std::string() : odometry;
}

void add_truth_option(CLI::App& command, std::vector<std::string>& truth) {
  command
      .add_option("--truth", truth,
                  "True poses of the nodes, TUM, KITTI or g2o, in place of recorded ones; for several robots "
                  "one file each; may be repeated")
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
        return "\"-\" is standard output, which gets the results: give a file name (./- for a file of that "
               "name; --json - prints the results as JSON)";
      },
      "");
}

Config load_config(const CommonOptions& options, const Config& defaults) {
  Config config = defaults;
  if (!options.config.empty()) read_config(options.config, config);
  for (const std::string& assignment : options.set) set_config_option(assignment, config);
  for (const std::string& assignment : options.reading) set_config_option(assignment, config);
  if (options.strict) config.mission.strict = true;
  validate_config(config);
  return config;
}

int thread_count(const CommonOptions& options) {
  return resolve_threads(options.threads);
}

bool is_recording(const std::filesystem::path& path) {
  const std::filesystem::path ending = path.extension();
  return std::filesystem::is_directory(path) || ending == ".bag" || ending == ".db3" || ending == ".mcap" ||
         ending == ".zstd" || ending == ".zip" || ending == ".json";
}

std::filesystem::path graph_of_run(const std::filesystem::path& folder) {
  const std::filesystem::path graph = folder / "graph.g2o";
  return std::filesystem::exists(folder / "summary.json") && std::filesystem::exists(graph)
             ? graph
             : std::filesystem::path();
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
  for (const char* name :
       {"mission.json", "result.g2o", "keys.csv", "optimized_poses.txt", "odom_poses.txt",
        "singlesession_posegraph.g2o", "poses.txt", "calib.txt", "graph.txt", "poses_tum.txt",
        "poses_kitti.txt", "pose.json", "alidarState.txt", "local_map_graph.g2o", "special_nodes.csv"}) {
    if (fs::exists(folder / name))
      throw OptionError(folder.string() + ": there is a recording (" + name + ")" + consequence);
  }
}

void print_results(const CommonOptions& options, const Json& json, const std::string& text) {
  // The text is made only if it is requested, because it may be long.
  print_json_text(options, options.json.empty() ? std::string() : json_text(json, 2) + "\n", text);
}

void print_json_text(const CommonOptions& options, const std::string& json, const std::string& text) {
  const bool to_output = options.json == "-";
  if (!options.json.empty() && !to_output) write_file(options.json, json);
  std::cout << (to_output ? json : text) << std::flush;
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
    std::fprintf(stderr, "%s: out of memory\n", program.c_str());  // allocates no memory
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
  // run_action() handles the exceptions of a command; this handles exceptions before it.
  try {
    return program(argc, argv);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", name);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", name, error.what());
  }
  return kFailed;
}

}  // namespace loopwise::cli
