// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "command.hpp"

namespace loopwise::cli {

/// Adds `study registration`.
void add_registration_study(CLI::App& study, Action& chosen);

/// Adds `study acceptance`.
void add_acceptance_study(CLI::App& study, Action& chosen);

/// Adds `study ablation`, `study budget` and `study rssi`: replays as units, see study_units.hpp.
void add_ablation_study(CLI::App& study, Action& chosen, Transport* job);
void add_budget_study(CLI::App& study, Action& chosen, Transport* job);
void add_rssi_study(CLI::App& study, Action& chosen, Transport* job);

}  // namespace loopwise::cli
