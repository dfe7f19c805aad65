// SPDX-License-Identifier: BSD-3-Clause
#include "odometry.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

#include <loopwise/core/random.hpp>

namespace loopwise::simulation_detail {

namespace parameters = simulation_parameters;

std::vector<Eigen::Isometry3d> measure_odometry(const std::vector<Eigen::Isometry3d>& truth,
                                                const std::vector<Eigen::Matrix3d>& scatter,
                                                const parameters::Platform& platform, std::uint64_t seed) {
  Rng rng(seed);
  double yaw_bias = platform.yaw_bias_rad_per_m * rng.normal();
  const double scale_bias = platform.scale_bias * rng.normal();
  // Attitude error against gravity, in the body frame. Gravity pulls it back, so that the estimate never
  // tumbles.
  Eigen::Vector2d tilt = Eigen::Vector2d::Zero();
  double burst_left = 0.0, burst_slip = 0.0, burst_yaw = 0.0;

  std::vector<Eigen::Isometry3d> steps;
  for (std::size_t k = 1; k < truth.size(); ++k) {
    const Eigen::Isometry3d motion = truth[k - 1].inverse() * truth[k];
    const double length = std::max(motion.translation().norm(), 1e-3);
    const double root = std::sqrt(length);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(0.5 * (scatter[k - 1] + scatter[k]));
    const double weakest = std::max(eigen.eigenvalues()[0], 1e-6);
    Eigen::Vector3d direction = eigen.eigenvectors().col(0);
    // The sign of an eigenvector depends on rounding, so the direction is turned forward.
    if (direction.dot(motion.translation()) < 0.0) direction = -direction;
    const double factor = std::clamp(std::sqrt(parameters::kDegeneracyReference / weakest), 1.0,
                                     parameters::kDegeneracyMaxFactor);

    const double chance = rng.uniform(), burst_length = rng.uniform();
    const double slip = parameters::kBurstSlip * rng.normal(),
                 twist = parameters::kBurstYawRadPerMetre * rng.normal();
    if (burst_left <= 0.0 && weakest < parameters::kBurstBelow &&
        chance < length * parameters::kBurstsPerMetre) {
      burst_left = parameters::kBurstLength.low +
                   burst_length * (parameters::kBurstLength.high - parameters::kBurstLength.low);
      burst_slip = slip;
      burst_yaw = twist;
    }
    const bool burst = burst_left > 0.0;
    burst_left -= length;

    const double keep = std::exp(-length / platform.bias_length_m);
    yaw_bias = keep * yaw_bias + std::sqrt(1.0 - keep * keep) * platform.yaw_bias_rad_per_m * rng.normal();
    const double hold = std::exp(-length / parameters::kGravityLength);
    const Eigen::Vector2d tilt_before = tilt;
    tilt = hold * tilt + platform.white_tilt_rad * root * Eigen::Vector2d(rng.normal(), rng.normal());

    Vector6d error;
    for (int i = 0; i < 3; ++i) error[i] = platform.white_m * root * rng.normal();
    const double along = platform.white_m * root * rng.normal() * std::sqrt(factor * factor - 1.0) +
                         (burst ? burst_slip * length : 0.0);
    error.head<3>() += scale_bias * motion.translation() + along * direction;
    error[3] = tilt.x() - tilt_before.x();
    error[4] = tilt.y() - tilt_before.y();
    error[5] = yaw_bias * length + platform.white_yaw_rad * root * rng.normal() * std::sqrt(factor) +
               (burst ? burst_yaw * length : 0.0);
    steps.push_back(motion * se3::exp(error));
  }
  return steps;
}

Matrix6d stated_information(double length_m) {
  const double share = std::max(length_m, 0.1) / 2.0;  // the stated sigmas are for steps of 2 m
  const auto weight = [share](double sigma) { return 1.0 / (sigma * sigma * share); };
  Matrix6d information = Matrix6d::Zero();
  for (int i = 0; i < 3; ++i) information(i, i) = weight(parameters::kStatedSigmaM);
  information(3, 3) = information(4, 4) = weight(parameters::kStatedSigmaTiltRad);
  information(5, 5) = weight(parameters::kStatedSigmaYawRad);
  return information;
}

}  // namespace loopwise::simulation_detail
