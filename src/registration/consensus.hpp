// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include <Eigen/Geometry>

namespace loopwise {

/// A source point and the target point that it may correspond to.
struct Match {
  Eigen::Vector3f source = Eigen::Vector3f::Zero();
  Eigen::Vector3f target = Eigen::Vector3f::Zero();
  Eigen::Vector3f source_normal = Eigen::Vector3f::Zero();
  Eigen::Vector3f target_normal = Eigen::Vector3f::Zero();
};

/// A pose that many matches support.
struct Hypothesis {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  std::size_t inliers = 0;
};

using PoseFilter = std::function<bool(const Eigen::Isometry3d& T_target_source)>;

/// The poses that the matches support.
struct Consensus {
  std::vector<Hypothesis> hypotheses;  ///< Most inliers first.
  std::size_t refused = 0;             ///< Number of poses that were not allowed.
};

/// Finds poses that sets of pairwise compatible matches support: at most `count`, all different and all
/// `allowed` (an empty function allows every pose). Two matches are compatible if their source points have
/// the same distance as their target points, within `tolerance_m`, and their normals differ by the same
/// angle. A match ranks by the number of compatible matches that it shares with its compatible matches
/// (second-order compatibility: Chen et al., SC2-PCR, CVPR 2022). This separates the few true matches from
/// random ones. The matches of highest rank each give one hypothesis. No random numbers. O(n²·n/64).
[[nodiscard]] Consensus find_consensus(const std::vector<Match>& matches, double tolerance_m,
                                       std::size_t count, const PoseFilter& allowed = {});

/// Rigid transform T with the least Σ |T·source − target|² over the chosen matches (Umeyama 1991).
[[nodiscard]] Eigen::Isometry3d fit_rigid(const std::vector<Match>& matches,
                                          const std::vector<std::size_t>& chosen);

}  // namespace loopwise
