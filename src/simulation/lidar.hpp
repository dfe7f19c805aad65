// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/simulation/ray_caster.hpp>
#include <loopwise/simulation/simulate.hpp>

namespace loopwise::simulation_detail {

/// Directions of a sweep's rays in the sensor's frame, column by column.
[[nodiscard]] std::vector<Eigen::Vector3f> beam_directions(LidarKind kind);

struct Sweep {
  PointCloud cloud;                                          ///< Sensor frame, without normals.
  Eigen::Matrix3d normal_scatter = Eigen::Matrix3d::Zero();  ///< Mean of n·nᵀ over the returns, sensor frame.
  std::uint64_t rays = 0;
};

/// One sweep from a sensor that stands still. A function of the pose and the seed.
[[nodiscard]] Sweep sweep(const RayCaster& caster, const std::vector<Eigen::Vector3f>& directions,
                          LidarKind kind, const Eigen::Isometry3d& T_world_sensor, std::uint64_t seed);

/// Thinning as in LAMP's front end: voxel centroids, with a voxel size adapted to the wanted number of
/// points, then at most `points` of them at random. The choice of a voxel depends on the voxel and the seed
/// alone. So a return that differs on another processor changes one point and not the whole choice.
[[nodiscard]] PointCloud thin(const PointCloud& cloud, int points, std::uint64_t seed);

}  // namespace loopwise::simulation_detail
