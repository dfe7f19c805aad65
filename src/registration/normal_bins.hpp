// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

/// Surface directions fall into 13 bins (faces, edges and corners of a cube, opposite ones joined, for a
/// surface may be seen from either side) and one for unknown normals. Scenes are mostly ground or mostly
/// walls: drawing or counting by bin gives weight to the few surfaces that fix the other directions.
inline constexpr std::size_t kNormalBins = 14;
inline constexpr std::size_t kUnknownNormal = 13;

[[nodiscard]] inline std::size_t normal_bin(const Eigen::Vector3f& normal) {
  if (normal.isZero(0.0F)) return kUnknownNormal;
  // Ternary digits of the direction: 0.38 = sin 22.5 deg parts a face's bin from the edges' around it.
  int code = 0;
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    const float c = normal[axis];
    code = 3 * code + (c > 0.38F ? 2 : c < -0.38F ? 0 : 1);
  }
  // 13 is the code of no direction, which no unit vector has; opposite directions have codes c and 26 − c.
  return static_cast<std::size_t>(code < 13 ? code : 26 - code);
}

/// `count` points with a normal, drawn in turn from the bins; all of them if they are fewer. Those drawn
/// first are spread like the rest, so a prefix is a draw of its own. Depends on the cloud alone.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::uint32_t> draw_balanced(const PointCloud& cloud,
                                                                       std::size_t count);

}  // namespace loopwise
