// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Running of commands: actions, exit statuses, and the report of exceptions.
#pragma once

#include <functional>
#include <string>

namespace loopwise::cli {

/// 0 done, 1 failed, 2 bad usage, 3 bad input, 130 interrupted.
enum ExitStatus : int { kDone = 0, kFailed = 1, kBadUsage = 2, kBadInput = 3, kInterrupted = 130 };

/// A chosen subcommand. Returns the exit status.
using Action = std::function<int()>;

/// Runs an action. Reports an exception as a line on standard error and an exit status.
[[nodiscard]] int run_action(const Action& action, const std::string& program = "loopwise");

/// The body of main(): runs a program, and reports any exception as a line on standard error and an exit
/// status. It also reports allocation failures that no catch block can reach.
[[nodiscard]] int run_main(const char* name, int (*program)(int argc, char** argv), int argc,
                           char** argv) noexcept;

}  // namespace loopwise::cli
