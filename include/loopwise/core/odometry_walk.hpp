// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <optional>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise {

/// Walks from a node along the odometry edges of its robot, towards higher or lower keys. Poses follow from
/// odometry and not from the estimate, so a later optimisation does not change them.
class LOOPWISE_EXPORT OdometryWalk {
 public:
  /// A node on the way.
  struct Place {
    std::size_t node = 0;  ///< Its number in the graph.
    /// Number of the odometry edge that leads to it. Without meaning where the walk began.
    std::size_t edge = 0;
    /// Its pose in the frame of the node where the walk began.
    Eigen::Isometry3d T_start_here = Eigen::Isometry3d::Identity();
  };

  /// \param graph must outlive the walk and not change
  /// \param robots must outlive the walk and not change
  /// \param start first node of the walk. \throws UnknownKeyError if it is not in the graph
  /// \param forward towards higher keys
  OdometryWalk(const PoseGraph& graph, const Robots& robots, Key start, bool forward)
      : graph_(graph), robots_(robots), forward_(forward), at_(Place{graph.index_of(start), 0}) {}

  /// The next node: among the neighbours by odometry, the one with the nearest key. Empty at the end of the
  /// chain.
  [[nodiscard]] std::optional<Place> next();

 private:
  const PoseGraph& graph_;
  const Robots& robots_;
  bool forward_;
  std::optional<Place> at_;
};

}  // namespace loopwise
