// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Parsing of the command line of loopwise, with error messages that name the remedy.
#pragma once

#include <optional>

#include "common/command_line.hpp"
#include "common/reference_pages.hpp"

namespace loopwise::cli {

/// Parses the command line. \returns the exit status if no command has to run.
/// \param first whether this process may print: only the first rank of a job does
[[nodiscard]] std::optional<int> parse(Command& app, int argc, char** argv, bool first);

/// Possible values of options, for completion.
[[nodiscard]] ValueWords value_words();

}  // namespace loopwise::cli
