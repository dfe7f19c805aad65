// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The mission that `loopwise replay` reads, and the folder that it writes.
#pragma once

#include <filesystem>
#include <optional>

#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/line_log.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/outcome_file.hpp>
#include <loopwise/replay/read_team.hpp>

#include "replay_command.hpp"

namespace loopwise::cli {

/// Reads the mission with its truth, and warns about everything that affects the replay.
[[nodiscard]] Team read_team(const ReplayCommand& options, const Config& config, ThreadPool& threads,
                             Console& console, const StopToken& stop);

/// The folder of a replay while it runs.
struct ReplayFolder {
  std::filesystem::path path;
  std::shared_ptr<OutcomeStore> store;  ///< Null unless outcomes are stored.
  std::optional<OutcomeFile> outcomes;  ///< Empty on a real clock.
  std::optional<LineLog> journal;
};
/// Prepares the folder for a new run or for the continuation of one. \throws OptionError
[[nodiscard]] ReplayFolder open_folder(const ReplayCommand& options, const Mission& mission,
                                       const Config& config, Console& console);

}  // namespace loopwise::cli
