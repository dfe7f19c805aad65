// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "odometry_forest.hpp"

namespace loopwise::detail {

/// How far each closure lies from what the known inliers alone say, before anything is solved: d² = rᵀS⁻¹r,
/// with r the residual at poses chained along odometry and S the closure's covariance plus that of the chain
/// between its ends, carried along to first order. A true closure's d² has six degrees of freedom (three in a
/// planar graph) if the information is honest. One value per edge in graph order; NaN for known inliers and
/// where no chain of known inliers and priors joins the ends.
[[nodiscard]] std::vector<double> innovations(const PoseGraph& graph, const OdometryForest& forest);

/// d² of a residual whose closure has this information, where the rest predicts with this covariance.
[[nodiscard]] double squared_innovation(const Matrix6d& information, const Matrix6d& prediction,
                                        const Vector6d& residual);

/// Covariance of the errors between two nodes, which the forest has on the left of poses, as an error on the
/// right of the pose T.
[[nodiscard]] Matrix6d on_the_right(const Matrix6d& between, const Eigen::Isometry3d& T);

/// d² of one edge with its residual at an estimate. S is the edge's covariance plus that of the path between
/// its ends in the forest; NaN if no path joins them. The forest holds some of the edges that the estimate
/// keeps, so S is at least the covariance of the whole estimate.
[[nodiscard]] double innovation(const PoseGraph& graph, const OdometryForest& forest, std::size_t edge,
                                const Vector6d& residual);

/// How far closures that an estimate leaves out lie from those that it keeps around them: d² = rᵀS⁻¹r with r
/// the residual at the estimate and S the closure's covariance plus that of the way from one end along
/// odometry to the nearest kept closure, across it, and on along odometry to the other end. That is one way
/// of many, so S bounds from above what the estimate allows.
class NeighbourInnovations {
 public:
  NeighbourInnovations(const PoseGraph& graph, const OdometryForest& forest)
      : graph_(graph), forest_(forest) {}

  /// The closures that the estimate keeps, by edge.
  void set_kept(const std::vector<std::size_t>& edges);
  struct Innovation {
    double d2 = std::numeric_limits<double>::quiet_NaN();
    /// Of the way, mean over the directions in which the closure's own is 1.
    double variance = std::numeric_limits<double>::infinity();
  };
  /// Of a closure with its residual; NaN and ∞ where no chain of odometry joins its ends, or one that is as
  /// sure as the way over a kept closure.
  [[nodiscard]] Innovation operator()(std::size_t edge, const Vector6d& residual) const;

 private:
  /// A kept closure seen from one of its ends.
  struct Kept {
    std::uint32_t root, other_root;    ///< Trees of this end and of the other
    std::uint32_t place, other_place;  ///< Places in the forest's tour
    std::uint32_t edge;
    bool reversed;    ///< Seen from the edge's `to`
    double variance;  ///< Of its covariance, mean over the directions
  };
  [[nodiscard]] const Kept* nearest(std::size_t from, std::size_t to, double variance_limit) const;
  [[nodiscard]] Matrix6d covariance_across(const Kept& kept, std::size_t from, std::size_t to) const;

  const PoseGraph& graph_;
  const OdometryForest& forest_;
  std::vector<Kept> kept_;
};

}  // namespace loopwise::detail
