// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include <Eigen/Core>

#include <loopwise/core/random.hpp>

namespace loopwise::detail {

/// The cube that contains a position, with this edge length, as a hash of its three indices. Indices beyond
/// ±2⁶² are clamped to that range, and NaN counts as index 0.
inline std::uint64_t cell_of(const Eigen::Vector3d& position, double cell_m) {
  constexpr double kLast = 4611686018427387904.0;  // 2⁶²
  std::uint64_t hash = 0;
  for (int k = 0; k < 3; ++k) {
    const double place = std::floor(position[k] / cell_m);
    const double within = std::isnan(place) ? 0.0 : std::clamp(place, -kLast, kLast);
    hash = combine_seeds(hash, static_cast<std::uint64_t>(static_cast<std::int64_t>(within)));
  }
  return hash;
}

}  // namespace loopwise::detail
