// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/se3.hpp>

#include "parameters.hpp"

namespace loopwise::simulation_detail {

/// Simulates lidar-inertial odometry between consecutive true poses. Errors are white noise, a yaw bias that
/// wanders, a scale bias, and roll and pitch errors that gravity pulls back on a straight way; turns rotate
/// them, so that they still add up slowly. Errors grow along the direction that the scan constrains least,
/// and bursts occur where the scan constrains it badly.
/// \param scatter mean of n·nᵀ of each pose's scan, body frame
/// \returns T_k_k+1, one fewer than poses
[[nodiscard]] std::vector<Eigen::Isometry3d> measure_odometry(const std::vector<Eigen::Isometry3d>& truth,
                                                              const std::vector<Eigen::Matrix3d>& scatter,
                                                              const simulation_parameters::Platform& platform,
                                                              std::uint64_t seed);

/// Information that the front end states for a step of `length_m`: [translation, rotation].
[[nodiscard]] Matrix6d stated_information(double length_m);

}  // namespace loopwise::simulation_detail
