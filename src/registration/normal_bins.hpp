// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/point_cloud.hpp>

namespace loopwise {

/// 13 bins of surface directions and one for unknown normals. The 13 are faces, edges and corners of a cube;
/// opposite directions share a bin, because a surface may be seen from either side. Most surfaces of a scene
/// are ground or parallel walls. Drawing or counting by bin gives weight to the few others that constrain the
/// remaining directions.
inline constexpr std::size_t kNormalBins = 14;
inline constexpr std::size_t kUnknownNormal = 13;

[[nodiscard]] inline std::size_t normal_bin(const Eigen::Vector3f& normal) {
  if (normal.isZero(0.0F)) return kUnknownNormal;
  // Ternary digits of the direction. 0.38 = sin 22.5 deg separates the bin of a face from those of its edges.
  int code = 0;
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    const float c = normal[axis];
    code = 3 * code + (c > 0.38F ? 2 : c < -0.38F ? 0 : 1);
  }
  // No unit vector has the code 13. Opposite directions have the codes c and 26 − c.
  return static_cast<std::size_t>(code < 13 ? code : 26 - code);
}

/// Draws `count` points with a normal in turn from the bins, or all of them if there are fewer. Each prefix
/// of the result is spread like the whole. Depends on the cloud alone.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::uint32_t> draw_balanced(const PointCloud& cloud,
                                                                       std::size_t count);

/// The same for a cloud in any memory. Normals that are not finite are unknown.
[[nodiscard]] std::vector<std::uint32_t> draw_balanced(const PointNormalView& cloud, std::size_t count);

}  // namespace loopwise
