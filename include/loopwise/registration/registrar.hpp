// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// A scan that takes part in a submap.
struct SubmapMember {
  Key key = 0;  ///< Node of the scan.
  /// Pose of the member's body in the frame of the submap's centre.
  Eigen::Isometry3d T_center_member = Eigen::Isometry3d::Identity();
  /// Covariance of that pose over the left perturbation Exp(ξ)·T_center_member, order translation, rotation,
  /// m² and rad². Zero: the pose is exact. Members with higher keys than the centre's lie on one path from
  /// it, nearest first, and those with lower keys on another. So the covariance of a member contains that of
  /// the nearer ones on its path.
  Matrix6d covariance = Matrix6d::Zero();
};

/// All input for the computation of one candidate, except the scans.
struct RegistrationTask {
  LoopCandidate candidate;  ///< Both ends.
  /// T_from_to by the graph: maps points of `to` (target) to `from` (source). It is tried first, and results
  /// must be near it; absent: no guess.
  std::optional<Eigen::Isometry3d> guess_from_to;
  /// Covariance of the guess over the right perturbation guess·Exp(ξ), order translation, rotation, m² and
  /// rad², for example OdometryCovariances. A registrar need not search where the guess is that unlikely;
  /// absent: not known.
  std::optional<Matrix6d> guess_covariance;
  std::vector<SubmapMember> source;  ///< Centre: candidate.from, at least {from, identity}.
  std::vector<SubmapMember> target;  ///< Centre: candidate.to, e.g. with its neighbours along the odometry.
  /// A submap takes its members nearest to the centre first, until it has this many downsampled points.
  /// Neighbours help sparse scans, but bring errors of the odometry into dense ones. 0: all members.
  std::size_t enough_points = 0;
  std::uint64_t seed = 0;  ///< Seed of all random numbers.
  /// Limit of wall time, s, after which the result is RejectionReason::kTimeLimit; 0: no limit.
  double time_limit_s = 0.0;
};

/// The task of two scans without submaps and guess: source `from`, target `to`. The result's T_from_to is the
/// pose of the target in the frame of the source, T_source_target, as in an edge of the graph. Its covariance
/// belongs to that transform, and guess_from_to has the same direction. align() has the opposite direction,
/// T_target_source.
[[nodiscard]] inline RegistrationTask pair_task(Key from, Key to, std::uint64_t seed) {
  RegistrationTask task;
  task.candidate.from = from;
  task.candidate.to = to;
  task.source = {{from}};
  task.target = {{to}};
  task.seed = seed;
  return task;
}

/// Computes a candidate: the result is a closure or a rejection with a reason. Thread-safe and without hidden
/// state: the result depends only on the task and its scans, except for wall times. With
/// RegistrationTask::time_limit_s it checks the time between its stages, so that it ends soon after the
/// limit.
class LOOPWISE_EXPORT Registrar {
 public:
  virtual ~Registrar() = default;
  /// Short and stable, for options, tables and journals.
  [[nodiscard]] virtual std::string_view name() const = 0;
  /// A candidate that cannot be computed is a result with a reason, not an exception.
  [[nodiscard]] virtual RegistrationResult compute(const RegistrationTask& task) const = 0;
};

}  // namespace loopwise
