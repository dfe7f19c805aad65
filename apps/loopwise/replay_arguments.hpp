// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options on the command line for replaying missions, shared by `replay` and the studies.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/replay/outcome_store.hpp>

#include "command.hpp"

namespace loopwise::cli {

struct ReplayArguments {
  std::string preset, candidates, robots, odometry, decisions, guess, registrar, registration_time;
  std::optional<std::int64_t> batch, max_registrations, skip_recent, thin;
  std::optional<double> gi_evaluation_time;
  std::vector<double> odometry_noise;
  std::optional<std::uint64_t> seed;
  std::string outcomes;
  bool appearance = false;
  OutcomeStoreOptions outcomes_bound;
  std::optional<double> rank_time_limit_s;
};

void add_replay_arguments(CLI::App& command, ReplayArguments& arguments);

/// Writes the given options to the configuration. \throws OptionError
void apply(const ReplayArguments& arguments, Config& config);

/// Reports the statistics of a store of outcomes as notes.
void note_outcomes(Console& console, const OutcomeStoreStatistics& statistics);

}  // namespace loopwise::cli
