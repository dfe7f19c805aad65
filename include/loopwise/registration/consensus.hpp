// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Poses that matches of points support, without random draws, alone. Takes matches of any origin.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>

namespace loopwise {

/// A source point and the target point that it may correspond to, each in the frame of its cloud, m. Zero
/// normals are unknown: distances alone then decide.
struct Match {
  Eigen::Vector3f source = Eigen::Vector3f::Zero();         ///< Point in the frame of the source, m.
  Eigen::Vector3f target = Eigen::Vector3f::Zero();         ///< Point in the frame of the target, m.
  Eigen::Vector3f source_normal = Eigen::Vector3f::Zero();  ///< Of unit length, or zero.
  Eigen::Vector3f target_normal = Eigen::Vector3f::Zero();  ///< Of unit length, or zero.
};

/// A pose that many matches support.
struct Hypothesis {
  /// Maps points of the source to the frame of the target: p_target = T_target_source · p_source.
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  std::size_t inliers = 0;  ///< Number of matches that the pose explains, at least 3.
};

/// Whether a pose may be a hypothesis, such as that it is near a guess.
using PoseFilter = std::function<bool(const Eigen::Isometry3d& T_target_source)>;

/// The poses that the matches support.
struct Consensus {
  std::vector<Hypothesis> hypotheses;  ///< Most inliers first.
  std::size_t refused = 0;             ///< Number of poses that were not allowed.
};

/// Options of consensus().
struct ConsensusOptions {
  /// Two matches agree if the distances between their points in the two clouds differ by less than this, m.
  /// About the voxel of the clouds.
  double tolerance_m = 0.6;
  /// Maximum number of poses.
  int max_hypotheses = 40;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("tolerance_m", self.tolerance_m, above(0.0));
    field("max_hypotheses", self.max_hypotheses, between(1.0, 1000.0));
  }
};

/// Finds poses that sets of pairwise compatible matches support: all different and all `allowed`. Two matches
/// are compatible if their source points have the same distance as their target points, within the tolerance,
/// and their normals differ by the same angle. A match ranks by the number of compatible matches that it
/// shares with its compatible matches (second-order compatibility: Chen et al., SC2-PCR, CVPR 2022). This
/// separates the few true matches from random ones. The matches of highest rank each give one hypothesis, the
/// rigid transform with the least sum of squares (Umeyama 1991). No random numbers. O(n²·n/64) time and n²/8
/// bytes for n matches: thousands of them take seconds.
/// \param matches hardly any needs to be right
/// \param options tolerance and number of poses
/// \param allowed a pose for which it returns false is left out; an empty function allows every pose
/// \throws OptionError; InputError if a match is not finite
[[nodiscard]] LOOPWISE_EXPORT Consensus consensus(const std::vector<Match>& matches,
                                                  const ConsensusOptions& options = {},
                                                  const PoseFilter& allowed = {});

}  // namespace loopwise
