// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>

namespace loopwise::bench {

/// Streets with this many poses and twice as many closures. The closures arrive in batches of 50: between
/// existing poses, and at the end of a path together with new poses. Prints the time of an update and of
/// optimize() from the same poses, and the distance between both results.
void compare_batches(std::size_t poses, std::uint64_t seed);

}  // namespace loopwise::bench
