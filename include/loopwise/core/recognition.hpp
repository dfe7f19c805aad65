// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include <Eigen/Geometry>

#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// Result of a place recognition for a candidate. Immutable, and shared by copies of the candidate.
struct Recognition {
  /// Similarity of the two places, in [0, 1]; NaN if unknown.
  double similarity = std::numeric_limits<double>::quiet_NaN();
  /// Guessed pose of `to` in the frame of `from`; absent: no guess. Registrations start from it and are
  /// compared with it instead of the relative pose of the graph.
  std::optional<Eigen::Isometry3d> T_from_to;
  /// Covariance of the guess, given that the place is the same: right perturbation, order [translation,
  /// rotation], m² and rad².
  Matrix6d covariance = Matrix6d::Identity();
};

/// Exchanges the two ends; inverts the recognised pose and transforms its covariance.
inline void swap_ends(LoopCandidate& candidate) {
  std::swap(candidate.from, candidate.to);
  if (!candidate.recognition || !candidate.recognition->T_from_to) return;
  auto turned = std::make_shared<Recognition>(*candidate.recognition);
  const Eigen::Isometry3d T_to_from = turned->T_from_to->inverse();
  turned->covariance = se3::covariance_of_inverse(*turned->T_from_to, turned->covariance);
  turned->T_from_to = T_to_from;
  candidate.recognition = std::move(turned);
}

}  // namespace loopwise
