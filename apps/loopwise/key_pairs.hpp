// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Lists of edges by their ends, as `optimize --odometry FILE` takes them.
#pragma once

#include <set>
#include <string>
#include <utility>

#include <loopwise/core/key.hpp>

namespace loopwise::cli {

/// Pairs of keys, one a line, separated by blanks or a comma; '#' starts a comment.
/// \throws ParseError naming `name` and the line
[[nodiscard]] std::set<std::pair<Key, Key>> parse_key_pairs(const std::string& contents,
                                                            const std::string& name);

}  // namespace loopwise::cli
