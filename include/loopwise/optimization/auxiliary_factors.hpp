// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// A range at two poses: whitened residual r (without unit) and its derivatives by T ⊕ [translation,
/// rotation].
struct LinearizedRange {
  double r = 0.0;                      ///< Whitened.
  Eigen::Matrix<double, 1, 6> J_from;  ///< By the pose of `from`.
  Eigen::Matrix<double, 1, 6> J_to;    ///< By the pose of `to`.
};

/// Where the two nodes coincide the direction of the range is not defined: both Jacobians are zero there.
[[nodiscard]] LOOPWISE_EXPORT LinearizedRange linearize(const RangeFactor& range,
                                                        const Eigen::Isometry3d& T_w_from,
                                                        const Eigen::Isometry3d& T_w_to);

/// Gravity at a pose: whitened residual and its derivative.
struct LinearizedGravity {
  Eigen::Vector3d r = Eigen::Vector3d::Zero();  ///< Whitened.
  Eigen::Matrix<double, 3, 6> J;                ///< By the node's pose.
};

/// At the pose of its node.
[[nodiscard]] LOOPWISE_EXPORT LinearizedGravity linearize(const GravityFactor& gravity,
                                                          const Eigen::Isometry3d& T_w_node);

}  // namespace loopwise
