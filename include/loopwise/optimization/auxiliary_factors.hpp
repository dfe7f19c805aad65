// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// A linearised range: whitened residual r (without unit) and its derivatives with respect to
/// T ⊕ [translation, rotation] of both poses.
struct LinearizedRange {
  double r = 0.0;                      ///< Whitened.
  Eigen::Matrix<double, 1, 6> J_from;  ///< With respect to the pose of `from`.
  Eigen::Matrix<double, 1, 6> J_to;    ///< With respect to the pose of `to`.
};

/// Linearises a range. If the two nodes coincide, the direction of the range is undefined and both Jacobians
/// are zero.
[[nodiscard]] LOOPWISE_EXPORT LinearizedRange linearize(const RangeFactor& range,
                                                        const Eigen::Isometry3d& T_w_from,
                                                        const Eigen::Isometry3d& T_w_to);

/// A linearised gravity factor: whitened residual and its derivative.
struct LinearizedGravity {
  Eigen::Vector3d r = Eigen::Vector3d::Zero();  ///< Whitened.
  Eigen::Matrix<double, 3, 6> J;                ///< With respect to the node's pose.
};

/// Linearises a gravity factor at the pose of its node.
[[nodiscard]] LOOPWISE_EXPORT LinearizedGravity linearize(const GravityFactor& gravity,
                                                          const Eigen::Isometry3d& T_w_node);

}  // namespace loopwise
