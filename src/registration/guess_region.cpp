// SPDX-License-Identifier: BSD-3-Clause
#include "guess_region.hpp"

#include <cmath>

namespace loopwise {
namespace {

// Near: within this part of the largest translation, and up to this height.
constexpr double kNearPart = 0.5, kNearHeightM = 2.5;
// Error of a pose that is not yet refined, m: half a cell of the votes.
constexpr double kStartSigmaM = 0.4;

}  // namespace

GuessRegion::GuessRegion(const RegistrationTask& task, const FastRegistrarOptions& options)
    : guess_from_to_(task.guess_from_to),
      near_m_(kNearPart * options.tests.max_translation_m),
      max_sq_deviation_(options.guess_sigmas * options.guess_sigmas) {
  if (!task.guess_from_to || !task.guess_covariance || options.guess_sigmas == 0.0) return;
  Eigen::Matrix3d covariance = task.guess_covariance->topLeftCorner<3, 3>();
  covariance.diagonal().array() += kStartSigmaM * kStartSigmaM;
  covariance_ = covariance.ldlt();
}

/// Translation from the guess to a pose, in the target's frame.
Eigen::Vector3d GuessRegion::moved(const Eigen::Isometry3d& T_target_source) const {
  return moved_from_guess(*guess_from_to_, T_target_source.inverse()).head<3>();
}

bool GuessRegion::is_near(const Eigen::Isometry3d& T_target_source) const {
  const Eigen::Vector3d by = moved(T_target_source);
  return std::abs(by.z()) <= kNearHeightM && by.norm() <= near_m_;
}

bool GuessRegion::contains(const Eigen::Isometry3d& T_target_source) const {
  if (!covariance_ || is_near(T_target_source)) return true;
  const Eigen::Vector3d by = moved(T_target_source);
  // A covariance that is not positive definite, from rounding, excludes nothing.
  return !covariance_->isPositive() || !(by.dot(covariance_->solve(by)) > max_sq_deviation_);
}

}  // namespace loopwise
