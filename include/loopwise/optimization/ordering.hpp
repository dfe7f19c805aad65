// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// A fill-reducing order of elimination for a symmetric sparse matrix (or matrix of blocks): approximate
/// minimum degree, then the postorder of the elimination tree, so that columns of one branch are neighbours.
/// `pairs` are the off-diagonal entries; they may repeat, in either direction.
/// \returns the variables in the order in which to eliminate them. \throws InputError if a pair names a
/// variable that does not exist.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::uint32_t> elimination_order(
    std::size_t variables, const std::vector<std::pair<std::uint32_t, std::uint32_t>>& pairs);

}  // namespace loopwise
