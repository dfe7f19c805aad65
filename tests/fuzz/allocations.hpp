// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Counts allocations of the test program by operator new: records their size, and makes one of them fail.
#pragma once

#include <atomic>
#include <cstddef>

namespace loopwise::fuzz {

extern std::atomic<std::size_t> largest_allocation;  ///< Bytes, since it was last set to 0.
/// Allocations until one fails; 0: none fails. Those of Eigen and of C libraries do not count.
extern std::atomic<long> allocations_until_none;

}  // namespace loopwise::fuzz
