// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Steps of `loopwise replay`.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/outcome_store.hpp>

#include "command.hpp"
#include "replay_arguments.hpp"

namespace loopwise {
struct WorkStatistics;
}

namespace loopwise::cli {

/// Options of `loopwise replay`.
struct ReplayCommand {
  CommonOptions common;
  std::vector<std::string> missions, truth;
  std::string frames;
  std::string bin_layout;
  bool start_together = false;
  std::string output;
  std::optional<std::string> method;
  std::string clock = "virtual";
  std::string trace, record_trace;
  ReplayArguments replay;
  std::optional<std::int64_t> workers;
  std::optional<double> rate;
  bool after_mission = false;
  bool resume = false;
  bool overwrite = false;
  double map_voxel_m = 0.2;
  bool map_ply = false;
  Transport* job = nullptr;  ///< Null unless the process is a rank of a job.
};

/// The configuration with the given options. \throws OptionError
[[nodiscard]] Config configured(const ReplayCommand& options);

/// Hashes all input that determines the outcomes of a run, except the contents of the scans. A run is resumed
/// only with the same input.
[[nodiscard]] std::string fingerprint(const Mission& mission, const Config& config);

/// Removes a file that would be mistaken for a result of the new run. \throws IoError
void remove_former(const std::filesystem::path& file);
/// Removes former results that a new run does not always overwrite. \throws IoError
void remove_former_results(const std::filesystem::path& folder);

/// The store of --outcomes, or null.
[[nodiscard]] std::shared_ptr<OutcomeStore> open_store(const ReplayArguments& arguments);

/// Replays a mission. \returns the exit status
int run_replay(const ReplayCommand& options);
/// Repeats a run of the online module. \returns the exit status
int run_trace(const ReplayCommand& options);

/// The work of a rank other than the first: computes registrations for it. \returns the exit status
int serve(const ReplayCommand& options);
/// Reports the work of the ranks as a note and as JSON.
void note_ranks(Console& console, const WorkStatistics& statistics, Json& json);

}  // namespace loopwise::cli
