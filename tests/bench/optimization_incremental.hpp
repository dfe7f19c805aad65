// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>

namespace loopwise::bench {

/// Streets of this many poses and twice as many closures, which come in batches of 50: between poses that are
/// there, and at the end of a path together with new poses. Prints what an update takes beside optimize()
/// from the same poses, and how far the poses of the two are apart.
void compare_batches(std::size_t poses, std::uint64_t seed);

}  // namespace loopwise::bench
