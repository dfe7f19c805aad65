// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/registration/fpfh.hpp>

namespace loopwise {

/// fpfh() without its checks: keys are indices of points, normals are finite.
[[nodiscard]] Descriptors compute_fpfh(const PointNormalView& cloud, const KdTree& tree,
                                       const std::vector<std::uint32_t>& keys, double radius_m,
                                       std::size_t max_neighbours);

}  // namespace loopwise
