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

namespace loopwise {

/// A scan that takes part in a submap.
struct SubmapMember {
  Key key = 0;  ///< Whose scan it is.
  /// Pose of the member's body in the frame of the submap's centre.
  Eigen::Isometry3d T_center_member = Eigen::Isometry3d::Identity();
};

/// All that the computation of one candidate depends on, besides the scans.
struct RegistrationTask {
  LoopCandidate candidate;  ///< Both ends.
  /// T_from_to by the graph. A hint to try first and the pose that a result must not stray from; absent: no
  /// idea.
  std::optional<Eigen::Isometry3d> guess_from_to;
  std::vector<SubmapMember> source;  ///< Centre: candidate.from, at least {from, identity}.
  std::vector<SubmapMember> target;  ///< Centre: candidate.to, e.g. with its neighbours along the odometry.
  /// A submap takes its members nearest to the centre first and no more of them once it has this many
  /// downsampled points: neighbours make up for sparse scans, and bring the odometry's error into dense ones.
  /// 0: all members.
  std::size_t enough_points = 0;
  std::uint64_t seed = 0;  ///< Of all random draws.
  /// Wall time after which to give up with RejectionReason::kTimeLimit, s; 0: none.
  double time_limit_s = 0.0;
};

/// The task of two scans alone, without guess: source `from`, target `to`.
[[nodiscard]] inline RegistrationTask pair_task(Key from, Key to, std::uint64_t seed) {
  RegistrationTask task;
  task.candidate.from = from;
  task.candidate.to = to;
  task.source = {{from, Eigen::Isometry3d::Identity()}};
  task.target = {{to, Eigen::Isometry3d::Identity()}};
  task.seed = seed;
  return task;
}

/// Turns a candidate into a closure or a stated rejection. Thread-safe, no hidden state: the result depends
/// on the task and its scans alone, wall times apart. With RegistrationTask::time_limit_s it looks at the
/// time between its stages, so that it ends soon after, not at, the limit.
class LOOPWISE_EXPORT Registrar {
 public:
  virtual ~Registrar() = default;
  /// Short and stable: stands in options, tables and journals.
  [[nodiscard]] virtual std::string_view name() const = 0;
  /// A candidate that cannot be computed is a result with a reason, not an exception.
  [[nodiscard]] virtual RegistrationResult compute(const RegistrationTask& task) const = 0;
};

}  // namespace loopwise
