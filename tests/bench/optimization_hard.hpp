// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Robust optimisation of graphs with many false closures and information that is wrong.
#pragma once

#include <cstdint>
#include <string>

namespace loopwise::bench {

/// Adds 10 to 70 % of false closures, random and in groups, to generated graphs and to the files of a folder
/// (empty: only generated ones), with information that is right, too optimistic for odometry, and too
/// pessimistic. One line a graph, then a summary. Only lines that contain `filter` are computed.
void compare_hard(std::uint64_t seed, const std::string& folder, const std::string& filter);

}  // namespace loopwise::bench
