// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options on the command line for replaying missions, shared by `replay` and the studies.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/replay/outcome_store.hpp>

#include "common/console.hpp"
#include "mission_options.hpp"

namespace loopwise::cli {

struct ReplayArguments {
  std::string preset, candidates, decisions, guess, registrar, registration_time;
  MissionArguments reading;
  std::optional<std::int64_t> batch, max_registrations, skip_recent, thin;
  std::optional<double> gi_evaluation_time;
  std::vector<double> odometry_noise;
  std::optional<std::uint64_t> seed;
  std::string outcomes;
  bool appearance = false;
  OutcomeStoreOptions outcomes_bound;
  std::optional<double> rank_time_limit_s;
};

/// Adds --preset.
void add_preset_option(Command& command, std::string& preset);
/// Adds --batch.
void add_batch_option(Command& command, std::optional<std::int64_t>& batch);
/// Adds all options of ReplayArguments, except those for joining several sources.
void add_replay_arguments(Command& command, ReplayArguments& arguments);

/// Writes the given options to the configuration. \throws OptionError
void apply(const ReplayArguments& arguments, Config& config);

/// The store of --outcomes, or null.
[[nodiscard]] std::shared_ptr<OutcomeStore> open_store(const ReplayArguments& arguments);
/// Reports the statistics of a store of outcomes as notes.
void note_outcomes(Console& console, const OutcomeStoreStatistics& statistics);

}  // namespace loopwise::cli
