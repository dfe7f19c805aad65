// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A yard of walls and boxes that scans are drawn from: no ray casting, every surface in range is seen.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <vector>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/random.hpp>
#include "testing.hpp"

namespace loopwise::testing {

class Scene {
 public:
  explicit Scene(std::uint64_t seed) {
    Rng rng(seed);
    add_rectangle({-30, -30, 0}, {60, 0, 0}, {0, 60, 0});
    for (int i = 0; i < 25; ++i) {
      const Eigen::Vector3d corner(rng.uniform(-25, 25), rng.uniform(-25, 25), 0);
      const double heading = rng.uniform(0.0, 3.14), height = rng.uniform(1.0, 6.0);
      const Eigen::Vector3d a =
          rng.uniform(1.0, 8.0) * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0);
      const Eigen::Vector3d b =
          rng.uniform(1.0, 4.0) * Eigen::Vector3d(-std::sin(heading), std::cos(heading), 0);
      const Eigen::Vector3d up(0, 0, height);
      add_rectangle(corner, a, up);
      add_rectangle(corner + b, a, up);
      add_rectangle(corner, b, up);
      add_rectangle(corner + a, b, up);
      add_rectangle(corner + up, a, b);
    }
  }

  /// `count` points within `range_m` of the pose, in its frame, with noise along all axes.
  [[nodiscard]] std::shared_ptr<PointCloud> scan(const Eigen::Isometry3d& pose, std::size_t count, Rng& rng,
                                                 double noise_m = 0.02, double range_m = 25.0) const {
    auto cloud = std::make_shared<PointCloud>();
    while (cloud->size() < count) {
      const double at = rng.uniform() * areas_.back();
      const auto face =
          static_cast<std::size_t>(std::lower_bound(areas_.begin(), areas_.end(), at) - areas_.begin());
      const auto& [corner, a, b] = rectangles_[face];
      Eigen::Vector3d p = corner + rng.uniform() * a + rng.uniform() * b;
      p += noise_m * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
      p = pose.inverse() * p;
      if (p.norm() <= range_m) cloud->points.push_back(p.cast<float>());
    }
    return cloud;
  }

 private:
  void add_rectangle(const Eigen::Vector3d& corner, const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
    rectangles_.push_back({corner, a, b});
    areas_.push_back((areas_.empty() ? 0.0 : areas_.back()) + a.cross(b).norm());
  }
  std::vector<std::array<Eigen::Vector3d, 3>> rectangles_;
  std::vector<double> areas_;  // cumulative
};

/// Pose on the ground with the sensor 1.5 m up.
[[nodiscard]] inline Eigen::Isometry3d ground_pose(double x, double y, double heading) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T.translation() << x, y, 1.5;
  return T;
}

using Scans = std::map<Key, std::shared_ptr<const PointCloud>>;

/// Loads from the map; null for a key that it lacks.
[[nodiscard]] inline ScanLoader loader(Scans scans) {
  return [scans = std::move(scans)](Key key) {
    const auto found = scans.find(key);
    return found == scans.end() ? nullptr : found->second;
  };
}

}  // namespace loopwise::testing
