// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// SE(3) with tangent vectors [translation, rotation] (m, rad) and perturbation on the right: T ⊕ ξ =
/// T·Exp(ξ). Formulas: Barfoot, State Estimation for Robotics, 2017, §7.1 (order of the tangent as here, left
/// and right Jacobians related by J_r(ξ) = J_l(−ξ)).
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>

namespace loopwise {

using Vector6d = Eigen::Matrix<double, 6, 1>;  ///< A tangent vector [translation, rotation], m and rad.
using Matrix6d = Eigen::Matrix<double, 6, 6>;  ///< A covariance or information of a tangent vector.

namespace se3 {

/// [v]×, the matrix of the cross product.
[[nodiscard]] inline Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

namespace detail {

/// Below this squared angle (rad²), Taylor series replace the closed forms, which lose digits.
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
[[nodiscard]] LOOPWISE_EXPORT Eigen::Matrix3d so3_exp(const Eigen::Vector3d& phi);

/// Rotation vector of unit length ≤ π of a rotation matrix; at exactly π one of the two opposite vectors.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Vector3d so3_log(const Eigen::Matrix3d& R);

/// Left Jacobian of SO(3): Exp(φ + δ) ≈ Exp(J_l δ) Exp(φ).
[[nodiscard]] LOOPWISE_EXPORT Eigen::Matrix3d so3_left_jacobian(const Eigen::Vector3d& phi);

/// Inverse left Jacobian of SO(3). Finite for angles of less than 2π.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Matrix3d so3_left_jacobian_inverse(const Eigen::Vector3d& phi);

/// Rigid motion of the tangent vector [ρ, φ]: rotation Exp(φ), translation J_l(φ)·ρ.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Isometry3d exp(const Vector6d& xi);

/// Tangent vector of a rigid motion, rotation of length ≤ π; exp(log(T)) = T.
[[nodiscard]] LOOPWISE_EXPORT Vector6d log(const Eigen::Isometry3d& T);

/// Ad(T): T·Exp(ξ)·T⁻¹ = Exp(Ad(T)·ξ).
[[nodiscard]] LOOPWISE_EXPORT Matrix6d adjoint(const Eigen::Isometry3d& T);

/// Left Jacobian: Exp(ξ + δ) ≈ Exp(J_l(ξ) δ)·Exp(ξ).
[[nodiscard]] LOOPWISE_EXPORT Matrix6d left_jacobian(const Vector6d& xi);

/// Inverse left Jacobian. Finite for rotations of less than 2π.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d left_jacobian_inverse(const Vector6d& xi);

/// Right Jacobian: Exp(ξ + δ) ≈ Exp(ξ)·Exp(J_r(ξ) δ).
[[nodiscard]] LOOPWISE_EXPORT Matrix6d right_jacobian(const Vector6d& xi);

/// Inverse right Jacobian: Log(Exp(ξ)·Exp(δ)) ≈ ξ + J_r⁻¹(ξ) δ. Finite for rotations of less than 2π.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d right_jacobian_inverse(const Vector6d& xi);

/// The same matrix in the tangent order [rotation, translation] of GTSAM and LAMP. The function is its own
/// inverse.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d swap_tangent_order(const Matrix6d& m);

/// Covariance of T⁻¹ when `covariance` is that of T (both right perturbations): Ad(T)·Σ·Ad(T)ᵀ.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d covariance_of_inverse(const Eigen::Isometry3d& T,
                                                             const Matrix6d& covariance);

/// Nearest rotation to a rotation matrix with rounding errors.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Isometry3d normalized(const Eigen::Isometry3d& T);

/// Distance of a matrix from a rotation: the largest entry of |R·Rᵀ − I|; infinite for a reflection and for
/// numbers that are not finite.
[[nodiscard]] LOOPWISE_EXPORT double rotation_defect(const Eigen::Matrix3d& R);

/// Angle of the rotation, rad, in [0, π].
[[nodiscard]] LOOPWISE_EXPORT double rotation_angle(const Eigen::Isometry3d& T);

}  // namespace se3
}  // namespace loopwise
