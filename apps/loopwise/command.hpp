// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The subcommands of loopwise. Each has one file with one function that adds it to the command line.
#pragma once

#include <CLI/CLI.hpp>

#include "common/common_options.hpp"
#include "common/console.hpp"

namespace loopwise {
class Transport;
}

namespace loopwise::cli {

void add_align(CLI::App& app, Action& chosen);
void add_config(CLI::App& app, Action& chosen);
void add_convert(CLI::App& app, Action& chosen);
void add_evaluate(CLI::App& app, Action& chosen);
void add_info(CLI::App& app, Action& chosen);
void add_optimize(CLI::App& app, Action& chosen);
void add_rank(CLI::App& app, Action& chosen);
void add_register(CLI::App& app, Action& chosen);
/// \param job the ranks of a parallel job that includes this process, or null. Ranks other than the first
/// print nothing.
void add_replay(CLI::App& app, Action& chosen, Transport* job);
void add_report(CLI::App& app, Action& chosen);
void add_study(CLI::App& app, Action& chosen, Transport* job);
#ifdef LOOPWISE_HAS_SIMULATION
void add_simulate(CLI::App& app, Action& chosen);
#endif

}  // namespace loopwise::cli
