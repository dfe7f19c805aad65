// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/random.hpp>

namespace loopwise::testing {

[[nodiscard]] inline PointCloud random_cloud(std::size_t count, bool normals, bool intensities,
                                             unsigned seed = 1) {
  Rng rng(seed);
  const auto vector = [&rng] {
    const double x = rng.normal(), y = rng.normal(), z = rng.normal();
    return Eigen::Vector3f(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z));
  };
  PointCloud cloud;
  for (std::size_t i = 0; i < count; ++i) {
    cloud.points.push_back(20.0f * vector());
    if (normals) {
      const Eigen::Vector3f normal = vector().normalized();
      cloud.normals.push_back(normal.dot(cloud.points.back()) > 0.0f ? Eigen::Vector3f(-normal) : normal);
    }
    if (intensities) cloud.intensities.push_back(static_cast<float>(rng.uniform(0.0, 255.0)));
  }
  return cloud;
}

}  // namespace loopwise::testing
