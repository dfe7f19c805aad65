// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include <Eigen/Core>

namespace loopwise {

/// Median of each coordinate, over at most 4096 points drawn evenly. Unlike a mean or a bounding box, it is
/// robust to a few distant points. Points that are not finite are ignored; without finite points it is zero.
/// \param points vector of Eigen vectors, or PointView
template <class Points>
[[nodiscard]] Eigen::Vector3d robust_centre(const Points& points) {
  constexpr std::size_t kLookedAt = 4096;
  const std::size_t count = std::min(points.size(), kLookedAt);
  std::vector<double> values;
  values.reserve(count);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    values.clear();
    for (std::size_t k = 0; k < count; ++k) {
      const auto& point = points[k * points.size() / count];
      if (point.allFinite()) values.push_back(static_cast<double>(point[axis]));
    }
    if (values.empty()) break;
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    centre[axis] = *middle;
  }
  return centre;
}

}  // namespace loopwise
