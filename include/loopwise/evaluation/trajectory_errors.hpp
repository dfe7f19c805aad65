// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Errors of an estimated trajectory of one or several robots.
///
/// Over the keys k that both hold, with X_k the estimated and Y_k the true pose of the body in the common
/// frame, and S the rigid motion of the chosen alignment, the pose error is E_k = Y_k⁻¹ · S · X_k:
///
///     e_k = |trans(E_k)|   (m)        θ_k = angle(E_k)   (rad, in [0, π])
///
/// *ATE* is the statistics of e_k and θ_k over all poses of all robots. The paper's ATE is the mean of e_k
/// with Alignment::kNone: its robots share a frame from the start.
///
/// *RPE* compares motions, so no alignment enters it: for two nodes i before j of one robot,
///
///     R_ij = (Y_i⁻¹ Y_j)⁻¹ · (X_i⁻¹ X_j),    |trans(R_ij)| in m,    angle(R_ij) in rad,
///
/// over all steps (i, j) between consecutive common keys of a robot, and for each requested distance d over
/// all pairs for which j is the first node with a path of at least length d from i along the truth.
///
/// *Per robot*, with s_k the length of the true path from the robot's first common node to node k, as in the
/// paper's Table II:
///
///     translation in % = 100 · mean e_k / s_k,     rotation in °/m = (180/π) · mean θ_k / s_k,
///
/// over the nodes with s_k ≥ min_path_m, beside the largest e_k (m) and θ_k (°) over all its nodes. (The
/// means that the paper prints for rotation are too large for °/m beside its largest errors; °/km would fit.)
#pragma once

#include <cstddef>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise {

/// Poses of the body in the common frame by node.
using PosesByKey = std::map<Key, Eigen::Isometry3d>;

/// The poses of a graph's nodes.
[[nodiscard]] LOOPWISE_EXPORT PosesByKey poses_by_key(const PoseGraph& graph);

/// The rigid motion S of the whole team that is applied to the estimate before the comparison. Never a scale.
enum class Alignment {
  kNone,   ///< S = 1: both are given in the common frame.
  kFirst,  ///< S = Y_k X_k⁻¹ for the smallest common key: the first pose of the first robot is right.
  kSe3,    ///< S minimises Σ |trans(Y_k) − S·trans(X_k)|² (Umeyama 1991, without scale).
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<Alignment> enum_names(Alignment);

/// Data that determined the rotation of Alignment::kSe3. Positions on one line leave the rotation about it
/// free, and positions in one point leave all of it free: the free part then minimises Σ ‖R_Y,k − R_S R_X,k‖²
/// over the orientations.
enum class AlignmentSupport {
  kPositions,  ///< Positions alone.
  kLine,       ///< Positions, and orientations for the rotation about their line: also of a path that is
               ///< narrower than its errors are large.
  kPoint,      ///< Orientations alone.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<AlignmentSupport> enum_names(AlignmentSupport);

/// S of the header's text over the common keys. \throws InputError as evaluate_trajectory.
struct AlignmentResult {
  Eigen::Isometry3d T_truth_estimate = Eigen::Isometry3d::Identity();  ///< S.
  AlignmentSupport support = AlignmentSupport::kPositions;             ///< kPositions unless kSe3.
};
/// The alignment of an estimate with the truth, over their common keys.
[[nodiscard]] LOOPWISE_EXPORT AlignmentResult align(const PosesByKey& estimate, const PosesByKey& truth,
                                                    Alignment alignment);

/// Statistics of a set of errors. For an empty set, count is 0 and the rest NaN.
struct Statistics {
  std::size_t count = 0;                                     ///< Errors in the set.
  double rmse = std::numeric_limits<double>::quiet_NaN();    ///< Root of the mean square.
  double mean = std::numeric_limits<double>::quiet_NaN();    ///< Arithmetic mean.
  double median = std::numeric_limits<double>::quiet_NaN();  ///< Mean of the middle two if count is even.
  double max = std::numeric_limits<double>::quiet_NaN();     ///< The largest.
};
/// \pre all finite and ≥ 0
[[nodiscard]] LOOPWISE_EXPORT Statistics statistics(std::vector<double> errors);

/// RPE over one distance, see the head of the file.
struct RelativeErrors {
  double distance_m = 0.0;   ///< d; 0 for the steps between consecutive nodes.
  Statistics translation_m;  ///< Of |trans(R_ij)|, m.
  Statistics rotation_rad;   ///< Of angle(R_ij), rad.
  /// 100 · mean of |trans(R_ij)| / s_ij and (180/π) · mean of angle(R_ij) / s_ij, s_ij the length of the true
  /// path. Pairs with s_ij < min_path_m do not count; NaN if none is left.
  double translation_percent = std::numeric_limits<double>::quiet_NaN();
  double rotation_deg_per_m = std::numeric_limits<double>::quiet_NaN();  ///< °/m, see translation_percent.
};

/// Errors of one robot.
struct RobotErrors {
  std::string name;                     ///< Of the robot.
  std::size_t poses = 0;                ///< Common to estimate and truth.
  double path_length_m = 0.0;           ///< Of the true path over the common nodes.
  double path_length_estimate_m = 0.0;  ///< Of the estimated one.
  Statistics ate_m;                     ///< Of e_k, m.
  Statistics ate_rad;                   ///< Of θ_k, rad.
  RelativeErrors step;                  ///< RPE between consecutive nodes.
  /// The paper's Table II; NaN if no node has s_k ≥ min_path_m.
  double translation_percent = std::numeric_limits<double>::quiet_NaN();
  double rotation_deg_per_m = std::numeric_limits<double>::quiet_NaN();  ///< °/m, as above.
};

/// Errors of a whole team, see the head of the file.
struct TrajectoryErrors {
  Alignment alignment = Alignment::kNone;   ///< The requested alignment.
  AlignmentResult applied;                  ///< The applied alignment.
  std::size_t poses = 0;                    ///< Common to both.
  std::size_t only_in_estimate = 0;         ///< Left out.
  std::size_t only_in_truth = 0;            ///< Left out.
  Statistics ate_m;                         ///< Of e_k over all poses, m.
  Statistics ate_rad;                       ///< Of θ_k over all poses, rad.
  RelativeErrors step;                      ///< All robots' steps.
  std::vector<RelativeErrors> by_distance;  ///< One per asked distance, in that order.
  std::vector<RobotErrors> robots;          ///< Those with a common pose, in the order of Robots.
};

/// Distances of relative errors.
struct TrajectoryEvaluationOptions {
  /// Path lengths over which relative errors are measured, m.
  std::vector<double> distances_m = {10.0, 50.0, 100.0};
  /// Shorter paths do not count in errors per distance, m.
  double min_path_m = 1.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("distances_m", self.distances_m, above(0.0));
    field("min_path_m", self.min_path_m, above(0.0));
  }
};

/// Compares the two over their common keys; the order of a robot's nodes is that of its keys. If `robots` is
/// empty, the characters of the keys identify the robots.
/// \throws InputError if the two share no key, or a pose is not finite or its rotation invalid (names the
/// key);
///         UnknownKeyError if a common key belongs to none of the robots; OptionError on bad options.
[[nodiscard]] LOOPWISE_EXPORT TrajectoryErrors
evaluate_trajectory(const PosesByKey& estimate, const PosesByKey& truth, Alignment alignment,
                    const Robots& robots = {}, const TrajectoryEvaluationOptions& options = {});

}  // namespace loopwise
