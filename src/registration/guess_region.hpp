// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <optional>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <loopwise/registration/fast_registrar.hpp>

namespace loopwise {

/// Where poses of a pair are searched, by its guess and the covariance of the guess.
class GuessRegion {
 public:
  GuessRegion(const RegistrationTask& task, const FastRegistrarOptions& options);

  /// Whether the covariance of the guess is known and used.
  [[nodiscard]] bool is_known() const { return covariance_.has_value(); }
  /// Whether a pose is near the guess. Few guesses are worse, and height drifts least, since gravity is
  /// known. Places that look alike are mostly further away, or on another floor.
  [[nodiscard]] bool is_near(const Eigen::Isometry3d& T_target_source) const;
  /// Whether a pose is near, or as likely as guess_sigmas requires. True for all poses without a guess.
  [[nodiscard]] bool contains(const Eigen::Isometry3d& T_target_source) const;

 private:
  [[nodiscard]] Eigen::Vector3d moved(const Eigen::Isometry3d& T_target_source) const;

  std::optional<Eigen::Isometry3d> guess_from_to_;
  double near_m_, max_sq_deviation_;
  std::optional<Eigen::LDLT<Eigen::Matrix3d>> covariance_;  // of the translation, in the target's frame
};

}  // namespace loopwise
