// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/auxiliary_factors.hpp>

#include <loopwise/core/se3.hpp>

namespace loopwise {

LinearizedRange linearize(const RangeFactor& range, const Eigen::Isometry3d& T_w_from,
                          const Eigen::Isometry3d& T_w_to) {
  const Eigen::Vector3d d = T_w_to.translation() - T_w_from.translation();
  const double length = d.norm();
  LinearizedRange out;
  out.r = (length - range.range_m) / range.sigma_m;
  out.J_from.setZero();
  out.J_to.setZero();
  if (!(length > 0.0)) return out;
  const Eigen::Vector3d u = d / (length * range.sigma_m);
  out.J_from.head<3>() = -u.transpose() * T_w_from.linear();
  out.J_to.head<3>() = u.transpose() * T_w_to.linear();
  return out;
}

LinearizedGravity linearize(const GravityFactor& gravity, const Eigen::Isometry3d& T_w_node) {
  const Eigen::Matrix3d R = T_w_node.linear() / gravity.sigma_rad;
  LinearizedGravity out;
  out.r = R * gravity.direction - gravity.reference / gravity.sigma_rad;
  out.J.leftCols<3>().setZero();
  out.J.rightCols<3>() = -R * se3::skew(gravity.direction);  // R Exp(φ) d ≈ R d + R (φ × d)
  return out;
}

}  // namespace loopwise
