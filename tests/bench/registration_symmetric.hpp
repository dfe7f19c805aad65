// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <string>

namespace loopwise::bench {

/// Registers pairs of scans within generated rooms, `count` with and without a guess of each kind ("all" or
/// the name of one), and prints how many wrong poses are verified with a covariance that excludes the truth.
void symmetric(const std::string& kinds, std::uint64_t count, std::uint64_t first_seed);

}  // namespace loopwise::bench
