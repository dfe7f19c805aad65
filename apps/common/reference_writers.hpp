// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Pages of the command line as manual pages and as completion for shells.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "reference_pages.hpp"

namespace loopwise::cli {

/// Writes PROGRAM.1 and PROGRAM-COMMAND.1 for each command. \throws IoError
void write_manuals(const CommandPage& root, const std::filesystem::path& folder);

[[nodiscard]] std::string bash_completion(const CommandPage& root);
[[nodiscard]] std::string zsh_completion(const CommandPage& root);
[[nodiscard]] std::string fish_completion(const CommandPage& root);

/// Visits a page, and then the pages of its commands in the same way.
void each_command(const CommandPage& page, const std::function<void(const CommandPage&)>& visit);

/// Patterns of a shell `case` for the paths of all commands: "loopwise info" | "loopwise study".
[[nodiscard]] std::string command_patterns(const CommandPage& root);

/// The command followed by each name of an option, as patterns for `case "$command $previous"`.
[[nodiscard]] std::string value_patterns(const CommandPage& page, const OptionPage& option);

/// Text in single quotes; `escape` replaces a quote in it.
[[nodiscard]] std::string single_quoted(const std::string& text, const std::string& escape);

}  // namespace loopwise::cli
