// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "odometry_forest.hpp"

namespace loopwise::detail {

/// The innovation where none is known.
constexpr double kNotKnown = std::numeric_limits<double>::quiet_NaN();

/// Innovation of each closure against the known inliers alone, without solving: d² = rᵀS⁻¹r. Here r is the
/// residual at poses chained along odometry, and S is the closure's covariance plus that of the chain between
/// its ends, propagated to first order. For a true closure, d² has six degrees of freedom (three in a planar
/// graph) if the stated information is correct. One value per edge in graph order. NaN for known inliers, and
/// if no chain of known inliers and priors joins the ends.
[[nodiscard]] std::vector<double> innovations(const PoseGraph& graph, const OdometryForest& forest);

/// d² of the residual of a closure with this information; `prediction` is the covariance of the predicted
/// relative pose.
[[nodiscard]] double squared_innovation(const Matrix6d& information, const Matrix6d& prediction,
                                        const Vector6d& residual);

/// Transforms the covariance between two nodes of the forest, where errors are on the left of poses, to an
/// error on the right of the pose T.
[[nodiscard]] Matrix6d on_the_right(const Matrix6d& between, const Eigen::Isometry3d& T);

/// d² of one edge with its residual at an estimate. S is the edge's covariance plus that of the path between
/// its ends in the forest; NaN if no path joins them. The forest contains only some of the edges that the
/// estimate keeps, so S is at least the covariance of the whole estimate.
[[nodiscard]] double innovation(const PoseGraph& graph, const OdometryForest& forest, std::size_t edge,
                                const Vector6d& residual);

/// Innovations d² = rᵀS⁻¹r of excluded closures against the kept closures around them. Here r is the residual
/// at the estimate, and S is the closure's covariance plus that of one path: along odometry to the nearest
/// kept closure, across it, and along odometry to the other end. The estimate rests on more paths than this,
/// so S is an upper bound on its covariance.
class NeighbourInnovations {
 public:
  NeighbourInnovations(const PoseGraph& graph, const OdometryForest& forest)
      : graph_(graph), forest_(forest) {}

  /// The closures that the estimate keeps, by edge.
  void set_kept(const std::vector<std::size_t>& edges);
  struct Innovation {
    double d2 = kNotKnown;
    /// Mean variance of the path, relative to the closure's own variance.
    double variance = std::numeric_limits<double>::infinity();
  };
  /// Innovation of a closure with its residual. NaN and ∞ if no chain of odometry joins its ends, or if that
  /// chain is at least as certain as the path across a kept closure.
  [[nodiscard]] Innovation operator()(std::size_t edge, const Vector6d& residual) const;

 private:
  /// A kept closure seen from one of its ends.
  struct Kept {
    std::uint32_t root, other_root;    ///< Trees of this end and of the other end
    std::uint32_t place, other_place;  ///< Positions in the forest's tour
    std::uint32_t edge;
    bool reversed;    ///< Seen from the edge's `to`
    double variance;  ///< Mean variance of its covariance over the free directions
  };
  [[nodiscard]] const Kept* nearest(std::size_t from, std::size_t to, double variance_limit) const;
  [[nodiscard]] Matrix6d covariance_across(const Kept& kept, std::size_t from, std::size_t to) const;

  const PoseGraph& graph_;
  const OdometryForest& forest_;
  std::vector<Kept> kept_;
};

}  // namespace loopwise::detail
