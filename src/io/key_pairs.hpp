// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Lists of edges by their ends, for the option odometry. Private to io.
#pragma once

#include <string>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise::parts {

/// Pairs of keys, one a line, separated by blanks or a comma; '#' starts a comment.
/// \throws ParseError naming `name` and the line
[[nodiscard]] KeyPairs parse_key_pairs(const std::string& contents, const std::string& name);

}  // namespace loopwise::parts
