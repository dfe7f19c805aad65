// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The subcommands of loopwise. Each has one file with one function that adds it to the command line.
#pragma once

#include "common/command_line.hpp"
#include "common/common_options.hpp"
#include "common/console.hpp"

namespace loopwise {
class Transport;
}

namespace loopwise::cli {

void add_align(Command& app, Action& chosen);
void add_config(Command& app, Action& chosen);
void add_convert(Command& app, Action& chosen);
void add_evaluate(Command& app, Action& chosen);
void add_info(Command& app, Action& chosen);
void add_optimize(Command& app, Action& chosen);
void add_rank(Command& app, Action& chosen);
void add_register(Command& app, Action& chosen);
/// \param job the ranks of a parallel job that includes this process, or null. Ranks other than the first
/// print nothing.
void add_replay(Command& app, Action& chosen, Transport* job);
void add_report(Command& app, Action& chosen);
void add_study(Command& app, Action& chosen, Transport* job);
#ifdef LOOPWISE_HAS_SIMULATION
void add_simulate(Command& app, Action& chosen);
#endif

}  // namespace loopwise::cli
