// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The output of `loopwise simulate`, as text and as JSON.
#pragma once

#include <string>

#include <loopwise/io/json_options.hpp>
#include <loopwise/simulation/simulate.hpp>

namespace loopwise::cli {

/// Adds the length and the drift of each robot. \returns the length of all paths, m
double add_robots(const Mission& mission, Json& json, std::string& text);
/// Adds the measurements of --statistics.
void add_statistics(const SimulatedMission& made, int threads, Json& json, std::string& text);

}  // namespace loopwise::cli
