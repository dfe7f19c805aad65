// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Requests for memory of the test program, by operator new: how large they are, and one that finds none.
#pragma once

#include <atomic>
#include <cstddef>

namespace loopwise::fuzz {

extern std::atomic<std::size_t> largest_allocation;  ///< Bytes, since it was last set to 0.
/// Requests up to the one that finds no memory; 0: all find some. Those of Eigen and of C are not among them.
extern std::atomic<long> allocations_until_none;

}  // namespace loopwise::fuzz
