// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Sites to recognise: walls, poles and ground, drawn from a seed.
#pragma once

#include <cmath>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise::testing {

inline Eigen::Isometry3d level_pose(double x, double y, double z, double yaw) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = se3::so3_exp({0.0, 0.0, yaw});
  T.translation() << x, y, z;
  return T;
}

/// What stands within `range_m` of a pose at the site of a seed, in the frame of the pose, with noise.
inline PointCloud site(std::uint64_t seed, const Eigen::Isometry3d& T_site_body, std::uint64_t noise_seed = 1,
                       double range_m = 60.0) {
  Rng rng(seed), noise(noise_seed);
  PointCloud cloud;
  const Eigen::Isometry3d to_body = T_site_body.inverse();
  const auto add = [&](double x, double y, double z) {
    const Eigen::Vector3d p(x + noise.normal(0.0, 0.02), y + noise.normal(0.0, 0.02), z);
    const Eigen::Vector3d seen = to_body * p;
    if (seen.norm() < range_m) cloud.points.push_back(seen.cast<float>());
  };
  for (int wall = 0; wall < 14; ++wall) {
    const double x = rng.uniform(-30.0, 30.0), y = rng.uniform(-30.0, 30.0), turn = rng.uniform(0.0, 3.1);
    const double length = rng.uniform(3.0, 12.0), height = rng.uniform(1.5, 5.0);
    for (double s = 0.0; s < length; s += 0.2) {
      for (double z = 0.0; z < height; z += 0.3) add(x + s * std::cos(turn), y + s * std::sin(turn), z);
    }
  }
  for (int pole = 0; pole < 15; ++pole) {
    const double x = rng.uniform(-25.0, 25.0), y = rng.uniform(-25.0, 25.0);
    for (double z = 0.0; z < 4.0; z += 0.1) add(x, y, z);
  }
  for (double x = -30.0; x < 30.0; x += 1.0) {
    for (double y = -30.0; y < 30.0; y += 1.0) add(x, y, 0.0);
  }
  return cloud;
}

}  // namespace loopwise::testing
