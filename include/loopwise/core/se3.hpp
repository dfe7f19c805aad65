// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// SE(3) with tangent vectors [translation, rotation] (m, rad) and perturbation on the right: T ⊕ ξ =
/// T·Exp(ξ). Formulas: Barfoot, State Estimation for Robotics, 2017, §7.1 (order of the tangent as here, left
/// and right Jacobians related by J_r(ξ) = J_l(−ξ)).
#pragma once

#include <cmath>
#include <limits>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace loopwise {

using Vector6d = Eigen::Matrix<double, 6, 1>;  ///< A tangent vector [translation, rotation], m and rad.
using Matrix6d = Eigen::Matrix<double, 6, 6>;  ///< A covariance or information over it.

namespace se3 {

/// [v]×, the matrix of the cross product.
[[nodiscard]] inline Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

namespace detail {

/// Below this squared angle (rad²) the coefficients that cancel come from their Taylor series.
inline constexpr double kSeriesBelow = 1e-2;

/// Coefficients of the powers of [φ]× in Exp and in the left Jacobian, θ = |φ|.
struct ExpCoefficients {
  double a;  ///< sin θ / θ
  double b;  ///< (1 − cos θ) / θ²
  double c;  ///< (θ − sin θ) / θ³
};

[[nodiscard]] inline ExpCoefficients exp_coefficients(double theta2) {
  if (theta2 < 1e-10) return {1.0 - theta2 / 6.0, 0.5 - theta2 / 24.0, 1.0 / 6.0 - theta2 / 120.0};
  const double theta = std::sqrt(theta2);
  const double s = std::sin(theta);
  const double half = std::sin(0.5 * theta);
  const double c = theta2 < kSeriesBelow
                       ? 1.0 / 6.0 - theta2 / 120.0 * (1.0 - theta2 / 42.0 * (1.0 - theta2 / 72.0))
                       : (theta - s) / (theta2 * theta);
  return {s / theta, 2.0 * half * half / theta2, c};
}

/// Coefficient of [φ]×² in the inverse Jacobian of SO(3): 1/θ² − (1 + cos θ) / (2 θ sin θ), finite up to θ =
/// π.
[[nodiscard]] inline double inverse_jacobian_coefficient(double theta2) {
  if (theta2 < kSeriesBelow)
    return 1.0 / 12.0 + theta2 / 720.0 * (1.0 + theta2 / 42.0 * (1.0 + theta2 / 40.0));
  const double half = 0.5 * std::sqrt(theta2);
  return (1.0 - half * std::cos(half) / std::sin(half)) / theta2;
}

}  // namespace detail

/// Rotation matrix of the rotation vector `phi`.
[[nodiscard]] inline Eigen::Matrix3d so3_exp(const Eigen::Vector3d& phi) {
  const auto k = detail::exp_coefficients(phi.squaredNorm());
  const Eigen::Matrix3d w = skew(phi);
  return Eigen::Matrix3d::Identity() + k.a * w + k.b * (w * w);
}

/// Rotation vector of unit length ≤ π of a rotation matrix; at exactly π one of the two opposite vectors.
[[nodiscard]] inline Eigen::Vector3d so3_log(const Eigen::Matrix3d& R) {
  // Through the quaternion: no cancellation near 0 (vector part) nor near π (scalar part).
  Eigen::Quaterniond q(R);
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const double n2 = q.vec().squaredNorm();
  if (n2 < 1e-14) return (2.0 / q.w() - 2.0 / 3.0 * n2 / (q.w() * q.w() * q.w())) * q.vec();
  const double n = std::sqrt(n2);
  return (2.0 * std::atan2(n, q.w()) / n) * q.vec();
}

/// Left Jacobian of SO(3): Exp(φ + δ) ≈ Exp(J_l δ) Exp(φ).
[[nodiscard]] inline Eigen::Matrix3d so3_left_jacobian(const Eigen::Vector3d& phi) {
  const auto k = detail::exp_coefficients(phi.squaredNorm());
  const Eigen::Matrix3d w = skew(phi);
  return Eigen::Matrix3d::Identity() + k.b * w + k.c * (w * w);
}

/// Its inverse. Finite for angles of less than 2π.
[[nodiscard]] inline Eigen::Matrix3d so3_left_jacobian_inverse(const Eigen::Vector3d& phi) {
  const Eigen::Matrix3d w = skew(phi);
  return Eigen::Matrix3d::Identity() - 0.5 * w +
         detail::inverse_jacobian_coefficient(phi.squaredNorm()) * (w * w);
}

/// Rigid motion of the tangent vector [ρ, φ]: rotation Exp(φ), translation J_l(φ)·ρ.
[[nodiscard]] inline Eigen::Isometry3d exp(const Vector6d& xi) {
  const Eigen::Vector3d phi = xi.tail<3>();
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = so3_exp(phi);
  T.translation() = so3_left_jacobian(phi) * xi.head<3>();
  return T;
}

/// Tangent vector of a rigid motion, rotation of length ≤ π; exp(log(T)) = T.
[[nodiscard]] inline Vector6d log(const Eigen::Isometry3d& T) {
  Vector6d xi;
  xi.tail<3>() = so3_log(T.linear());
  xi.head<3>() = so3_left_jacobian_inverse(xi.tail<3>()) * T.translation();
  return xi;
}

/// Ad(T): T·Exp(ξ)·T⁻¹ = Exp(Ad(T)·ξ).
[[nodiscard]] inline Matrix6d adjoint(const Eigen::Isometry3d& T) {
  Matrix6d ad;
  ad.topLeftCorner<3, 3>() = T.linear();
  ad.topRightCorner<3, 3>() = skew(T.translation()) * T.linear();
  ad.bottomLeftCorner<3, 3>().setZero();
  ad.bottomRightCorner<3, 3>() = T.linear();
  return ad;
}

namespace detail {

/// Q(ρ, φ), the coupling of translation and rotation in SE(3)'s left Jacobian (Barfoot eq. 7.86b).
[[nodiscard]] inline Eigen::Matrix3d jacobian_coupling(const Eigen::Vector3d& rho,
                                                       const Eigen::Vector3d& phi) {
  const double t2 = phi.squaredNorm();
  double c1 = 0.0;  // (θ − sin θ) / θ³
  double c2 = 0.0;  // (θ²/2 + cos θ − 1) / θ⁴
  double c3 = 0.0;  // (2θ + θ cos θ − 3 sin θ) / (2θ⁵)
  if (t2 < 1.0) {
    // The closed forms cancel up to the fifth power. Terms of their series are (−θ²)^k over a factorial.
    double p = 1.0, f3 = 6.0, f4 = 24.0, f5 = 120.0;
    for (int k = 0; k < 10; ++k) {
      c1 += p / f3;
      c2 += p / f4;
      c3 += p * (1.0 + k) / f5;
      const double n = 2.0 * k;
      f3 *= (n + 4.0) * (n + 5.0);
      f4 *= (n + 5.0) * (n + 6.0);
      f5 *= (n + 6.0) * (n + 7.0);
      p *= -t2;
    }
  } else {
    const double t = std::sqrt(t2), s = std::sin(t), c = std::cos(t);
    c1 = (t - s) / (t2 * t);
    c2 = (0.5 * t2 + c - 1.0) / (t2 * t2);
    c3 = (2.0 * t + t * c - 3.0 * s) / (2.0 * t2 * t2 * t);
  }
  const Eigen::Matrix3d r = skew(rho), w = skew(phi);
  const Eigen::Matrix3d wr = w * r, rw = r * w, wrw = wr * w;
  const Eigen::Matrix3d ww = w * w;
  return 0.5 * r + c1 * (wr + rw + wrw) + c2 * (ww * r + r * ww - 3.0 * wrw) + c3 * (wrw * w + w * wrw);
}

}  // namespace detail

/// Left Jacobian: Exp(ξ + δ) ≈ Exp(J_l(ξ) δ)·Exp(ξ).
[[nodiscard]] inline Matrix6d left_jacobian(const Vector6d& xi) {
  const Eigen::Vector3d rho = xi.head<3>(), phi = xi.tail<3>();
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = J.bottomRightCorner<3, 3>() = so3_left_jacobian(phi);
  J.topRightCorner<3, 3>() = detail::jacobian_coupling(rho, phi);
  return J;
}

/// Its inverse. Finite for rotations of less than 2π.
[[nodiscard]] inline Matrix6d left_jacobian_inverse(const Vector6d& xi) {
  const Eigen::Vector3d rho = xi.head<3>(), phi = xi.tail<3>();
  const Eigen::Matrix3d j = so3_left_jacobian_inverse(phi);
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = J.bottomRightCorner<3, 3>() = j;
  J.topRightCorner<3, 3>() = -j * detail::jacobian_coupling(rho, phi) * j;
  return J;
}

/// Right Jacobian: Exp(ξ + δ) ≈ Exp(ξ)·Exp(J_r(ξ) δ).
[[nodiscard]] inline Matrix6d right_jacobian(const Vector6d& xi) {
  return left_jacobian(-xi);
}

/// Inverse right Jacobian: Log(Exp(ξ)·Exp(δ)) ≈ ξ + J_r⁻¹(ξ) δ. Finite for rotations of less than 2π.
[[nodiscard]] inline Matrix6d right_jacobian_inverse(const Vector6d& xi) {
  return left_jacobian_inverse(-xi);
}

/// The same matrix with tangent order [rotation, translation], as GTSAM and LAMP hold it; its own inverse.
[[nodiscard]] inline Matrix6d swap_tangent_order(const Matrix6d& m) {
  Matrix6d out;
  out.topLeftCorner<3, 3>() = m.bottomRightCorner<3, 3>();
  out.topRightCorner<3, 3>() = m.bottomLeftCorner<3, 3>();
  out.bottomLeftCorner<3, 3>() = m.topRightCorner<3, 3>();
  out.bottomRightCorner<3, 3>() = m.topLeftCorner<3, 3>();
  return out;
}

/// Covariance of T⁻¹ when `covariance` is that of T (both right perturbations): Ad(T)·Σ·Ad(T)ᵀ.
[[nodiscard]] inline Matrix6d covariance_of_inverse(const Eigen::Isometry3d& T, const Matrix6d& covariance) {
  const Matrix6d ad = adjoint(T);
  const Matrix6d moved = ad * covariance * ad.transpose();
  return 0.5 * (moved + moved.transpose());
}

/// Nearest rotation to a rotation matrix with rounding errors.
[[nodiscard]] inline Eigen::Isometry3d normalized(const Eigen::Isometry3d& T) {
  Eigen::Isometry3d out = T;
  out.linear() = Eigen::Quaterniond(T.linear()).normalized().toRotationMatrix();
  return out;
}

/// Distance of a matrix from a rotation: the largest entry of |R·Rᵀ − I|; infinite for a reflection and for
/// numbers that are not finite.
[[nodiscard]] inline double rotation_defect(const Eigen::Matrix3d& R) {
  const Eigen::Matrix3d off = R * R.transpose() - Eigen::Matrix3d::Identity();
  if (!off.allFinite() || R.determinant() < 0.0) return std::numeric_limits<double>::infinity();
  return off.cwiseAbs().maxCoeff();
}

/// Angle of the rotation, rad, in [0, π].
[[nodiscard]] inline double rotation_angle(const Eigen::Isometry3d& T) {
  return so3_log(T.linear()).norm();
}

}  // namespace se3
}  // namespace loopwise
