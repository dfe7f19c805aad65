// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// A computed candidate that passed all tests of the registration: *verified*.
struct LoopClosure {
  Key from = 0;  ///< The newer node, as of the candidate.
  Key to = 0;    ///< The older node.
  /// Pose of `to` in the frame of `from`: p_from = T_from_to · p_to.
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();
  /// Of T_from_to, right perturbation, order [translation, rotation], m² and rad². Symmetric positive
  /// definite.
  Matrix6d covariance = Matrix6d::Identity();
};

/// Why a computed candidate is not a closure. closures.csv and summary.json have its enum_name().
enum class RejectionReason {
  kNone,          ///< Not rejected.
  kMissingScan,   ///< A node without a scan, or one whose file cannot be read.
  kTooFewPoints,  ///< A scan or its key points are too few to align.
  kFewMatches,    ///< Too few feature correspondences or inliers.
  kSacFitness,    ///< Feature-based stage: mean squared distance above the bound.
  kGicpFitness,   ///< Refinement: mean squared distance above the bound.
  kLowOverlap,    ///< Too few points of the source are on the target.
  kInconsistent,  ///< The surfaces do not match in detail, or one scan has points in free space of the other.
  kAmbiguous,     ///< Another pose, far away, fits as well.
  kDegenerate,    ///< The scans leave too many directions of the relative pose free.
  kTransformThreshold,  ///< The pose is too far from the graph's relative pose.
  kNotConverged,        ///< Refinement did not converge, or gave numbers that are not finite.
  kFailed,              ///< The registrar threw; see the message.
  kTimeLimit,           ///< It took longer than RegistrationTask::time_limit_s.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<RejectionReason> enum_names(RejectionReason);

/// Whether the reason concerns this attempt and not the pair: an unreadable file, an exception, or a machine
/// that was too slow. Such a result is not stored for other runs, and a resumed run tries the pair again.
[[nodiscard]] inline bool depends_on_circumstances(RejectionReason reason) {
  return reason == RejectionReason::kMissingScan || reason == RejectionReason::kFailed ||
         reason == RejectionReason::kTimeLimit;
}

/// The result of one candidate. A candidate that cannot be computed is a result with a reason, not an error.
struct RegistrationResult {
  LoopCandidate candidate;                          ///< The computed candidate.
  RejectionReason reason = RejectionReason::kNone;  ///< kNone if it was verified.
  std::string message;                 ///< For users: figures and their bounds. Empty if verified.
  std::optional<LoopClosure> closure;  ///< Present exactly if reason is kNone.

  /// The last transform, T_from_to, also for a rejected candidate; empty if no transform was found.
  std::optional<Eigen::Isometry3d> T_from_to;
  /// Mean squared nearest-neighbour distance after the feature-based stage, m². NaN if it did not run.
  double sac_fitness_m2 = std::numeric_limits<double>::quiet_NaN();
  /// Mean squared nearest-neighbour distance over all source points after refinement, m². NaN if it did not
  /// run.
  double gicp_fitness_m2 = std::numeric_limits<double>::quiet_NaN();
  /// Share of source points with a target point nearby after refinement, [0, 1]. NaN if not measured.
  double overlap = std::numeric_limits<double>::quiet_NaN();
  double features_s = 0.0;  ///< Wall time of features and submaps, s. For reports only, as the next two.
  double global_s = 0.0;    ///< Of the feature-based stage, s.
  double refine_s = 0.0;    ///< Of refinement and tests, s.
  /// A neighbour's scan could not be read: a submap lacks it.
  bool incomplete = false;
  /// hash_of() the task, if a replay has recorded it; 0: unknown.
  std::uint64_t task_hash = 0;

  /// Whether it passed all tests of the computation.
  [[nodiscard]] bool verified() const { return reason == RejectionReason::kNone && closure.has_value(); }
  /// Wall time of all stages, s.
  [[nodiscard]] double seconds() const { return features_s + global_s + refine_s; }
};

/// Whether the result depends on circumstances: by its reason, or because a neighbour's scan could not be
/// read.
[[nodiscard]] inline bool depends_on_circumstances(const RegistrationResult& result) {
  return result.incomplete || depends_on_circumstances(result.reason);
}

}  // namespace loopwise
