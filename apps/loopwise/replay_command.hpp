// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Steps of `loopwise replay`.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/config.hpp>

#include "common/common_options.hpp"
#include "common/console.hpp"
#include "replay_arguments.hpp"

namespace loopwise {
class Registrar;
class Transport;
class WorkServer;
struct Mission;
struct ReplayHooks;
}  // namespace loopwise

namespace loopwise::cli {

/// Options of `loopwise replay`.
struct ReplayCommand {
  CommonOptions common;
  std::vector<std::string> missions, truth;
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

/// Replays a mission. \returns the exit status
int run_replay(const ReplayCommand& options);
/// Repeats a run of the online module. \returns the exit status
int run_trace(const ReplayCommand& options);

/// The work of a rank other than the first: computes registrations for it. \returns the exit status
int serve(const ReplayCommand& options);
/// Lets the ranks of the job compute registrations for a replay.
[[nodiscard]] std::shared_ptr<WorkServer> use_ranks(const ReplayCommand& options, const Mission& mission,
                                                    const ReplayOptions& replay,
                                                    const std::shared_ptr<const Registrar>& registrar,
                                                    ReplayHooks& hooks);
/// Reports the work of the ranks as a note and as JSON.
void note_ranks(Console& console, const WorkServer& server, Json& json);

}  // namespace loopwise::cli
