// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Manual pages and completion for bash, zsh and fish. They are generated from the command line, so that they
/// always agree with it.
#pragma once

#include <filesystem>

#include "action.hpp"
#include "command_line.hpp"
#include "reference_pages.hpp"

namespace loopwise::cli {

/// Adds the command `reference DIR`, which help does not list; the build runs it.
void add_reference(Command& app, Action& chosen, const ValueWords& words);

/// Writes folder/man/man1/*.1, folder/bash-completion/completions/NAME, folder/zsh/site-functions/_NAME and
/// folder/fish/vendor_completions.d/NAME.fish: the tree of /usr/share. \throws IoError
void write_reference(const Command& app, const ValueWords& words, const std::filesystem::path& folder);

}  // namespace loopwise::cli
