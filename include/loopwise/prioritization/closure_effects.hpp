// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>

namespace loopwise {

/// Effect of each candidate, added alone, on the positions of a sample of nodes: the input of EffectNetwork.
///
/// Nodes are ordered along their robots' chains of odometry and divided into strata of equal measure, half by
/// count and half by variance. The middle node of a stratum, the *anchor*, represents it. The principal axes
/// of an anchor's positional covariance are three *units*, each with one variance v. One closure lowers it to
/// v', exactly: v − v' = yᵀ(W⁻¹ + JΣJᵀ)⁻¹y, y = JΣn for the axis n. Poses, variances and closures are those
/// that CovarianceObjective counts.
struct LOOPWISE_EXPORT ClosureEffects {
  /// The node that represents a stratum, with the uncertainty of its position.
  struct Anchor {
    std::size_t node = 0;     ///< Its number in the graph.
    std::uint32_t chain = 0;  ///< Anchors of one chain are consecutive, in its order.
    Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();         ///< Columns, world frame; variance falling.
    Eigen::Vector3d variance = Eigen::Vector3d::Constant(0.0);  ///< Along them, m².
  };
  /// Position of a closure's ends on the chain of an anchor.
  enum Side : std::uint8_t { kBefore = 0, kAfter = 1, kAround = 2, kElsewhere = 3 };

  double trace_m2 = 0.0;        ///< e(PG): sum of the variances of all positions.
  std::vector<Anchor> anchors;  ///< Chain by chain, in their order along it.
  Eigen::VectorXd share;        ///< By unit: its stratum's part of the trace along that axis. Sums to 1.
  Eigen::MatrixXd units = Eigen::MatrixXd::Zero(0, kUnitFeatures);  ///< A row of kUnitFeatures for each unit.
  Eigen::MatrixXf log_reduction;  ///< Units × candidates: log(v / v'), in [0, kMaxLogReduction].
  Eigen::Matrix<std::uint8_t, Eigen::Dynamic, Eigen::Dynamic> side;  ///< Anchors × candidates: Side.
  Eigen::MatrixXf gap;  ///< Anchors × candidates: log(1 + nodes to the nearest end); 0 if elsewhere.
  Eigen::MatrixXf far;  ///< The same to the other end; 0 unless both lie on the anchor's chain.
  /// Anchors × candidates: log((v_end + σ²) / (v_anchor + σ²)) of mean positional variances, for the end with
  /// the smaller variance.
  Eigen::MatrixXf reference;
  Eigen::VectorXd gain;          ///< By candidate: relative decrease of the trace by it alone.
  std::vector<bool> connecting;  ///< By candidate, as GraphObjective::connecting.

  /// log(v / σ²) for the closures' σ, log(v / mean variance of the graph), 1 on the first and on the second
  /// axis, log(number of nodes).
  static constexpr Eigen::Index kUnitFeatures = 5;
  /// log_reduction; before, after, around, elsewhere (one of them 1); gap; log(1e-6 + gain); far; reference
  static constexpr Eigen::Index kEdgeFeatures = 9;
  static constexpr double kMaxLogReduction = 9.0;  ///< Bound of `log_reduction`.

  /// Units: three for each anchor.
  [[nodiscard]] Eigen::Index unit_count() const { return share.size(); }
  /// Number of candidates.
  [[nodiscard]] Eigen::Index candidates() const { return log_reduction.cols(); }
  /// A row of kEdgeFeatures for each unit: the effect of a candidate's closure there.
  [[nodiscard]] Eigen::MatrixXd edge_features(Eigen::Index candidate) const;
};

inline constexpr std::size_t kEffectAnchors = 64;  ///< Default number of strata.

/// Effects of all candidates: a sparse solve for each. `count` is the number of strata.
/// \throws as CovarianceObjective
[[nodiscard]] LOOPWISE_EXPORT ClosureEffects closure_effects(const PoseGraph& graph,
                                                             const std::vector<LoopCandidate>& candidates,
                                                             const ClosureModelOptions& options,
                                                             const ClosureModel& model,
                                                             std::size_t count = kEffectAnchors);

/// log(v / v'), not bounded, of each unit for covariances of the same nodes after a change, as in Marginals:
/// the training target of EffectNetwork.
[[nodiscard]] LOOPWISE_EXPORT Eigen::VectorXd unit_log_reductions(const ClosureEffects& effects,
                                                                  const PoseGraph& graph,
                                                                  const std::vector<Matrix6d>& covariances);

}  // namespace loopwise
