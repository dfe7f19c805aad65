// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options on the command line that the studies of replays share, and the output of their results.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/study/study.hpp>

#include "common/common_options.hpp"
#include "common/console.hpp"
#include "replay_arguments.hpp"

namespace loopwise::cli {

/// Options of a study of replays.
struct StudyArguments {
  CommonOptions common;
  ReplayArguments replay;
  std::vector<std::string> missions, truth;
  std::string output;
  std::int64_t seeds = 1;
  bool keep_runs = false;
  bool resume = false;
  Transport* job = nullptr;
};
void add_study_arguments(Command& command, StudyArguments& arguments);

/// \throws OptionError
[[nodiscard]] study::StudyOptions study_options(const StudyArguments& arguments);

/// Runs a study with these arguments, writes NAME.json, NAME.md and the CSV file, and prints the tables.
/// \returns the exit status
[[nodiscard]] int run_study(const StudyArguments& arguments, const std::string& name, const std::string& csv,
                            const std::function<std::optional<study::StudyReport>(
                                const study::StudyOptions&, const study::StudyHooks&)>& run);

/// Adds `study ablation`, `study budget` and `study rssi`.
void add_replay_studies(Command& app, Action& chosen, Transport* job);
/// Adds `study registration`.
void add_registration_study(Command& app, Action& chosen);
/// Adds `study acceptance`.
void add_acceptance_study(Command& app, Action& chosen);

}  // namespace loopwise::cli
