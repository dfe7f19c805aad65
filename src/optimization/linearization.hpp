// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Residuals and derivatives of relative poses with few operations, inline: they are the innermost loop of
/// the optimisation.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/se3.hpp>

namespace loopwise::detail {

struct Pose {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
};

inline Pose inverse(const Eigen::Isometry3d& T) {
  Pose out;
  out.R = T.linear().transpose();
  out.t = -(out.R * T.translation());
  return out;
}

inline Eigen::Isometry3d isometry(const Pose& pose) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = pose.R;
  T.translation() = pose.t;
  return T;
}

/// T_a⁻¹ T_b
inline Pose between(const Pose& a, const Pose& b) {
  Pose out;
  out.R.noalias() = a.R.transpose() * b.R;
  out.t.noalias() = a.R.transpose() * (b.t - a.t);
  return out;
}

/// se3::so3_log(), with a series for residuals: atan(x)/x = Σ (−x²)ᵏ/(2k+1) for the tangent x of half the
/// angle.
inline Eigen::Vector3d rotation_vector(const Eigen::Matrix3d& R) {
  const double trace = R.trace();
  if (!(trace > 2.96)) return se3::so3_log(R);  // 0.2 rad; the first omitted term is below 1e-17 then
  const double four_w2 = 1.0 + trace;
  const Eigen::Vector3d twice(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));  // 4w·vec(q)
  const double x2 = twice.squaredNorm() / (four_w2 * four_w2);
  double series = 1.0 / 15;
  for (const double term : {1.0 / 13, 1.0 / 11, 1.0 / 9, 1.0 / 7, 1.0 / 5, 1.0 / 3, 1.0})
    series = term - x2 * series;
  return (2.0 * series / four_w2) * twice;
}

inline Vector6d log_of_product(const Pose& z, const Pose& e) {
  Vector6d r;
  const Eigen::Matrix3d R = z.R * e.R;
  const Eigen::Vector3d phi = rotation_vector(R);
  const Eigen::Vector3d t = z.R * e.t + z.t;
  // J_l⁻¹(φ) t without forming the matrix.
  const Eigen::Vector3d wt = phi.cross(t);
  r.head<3>() = t - 0.5 * wt + se3::detail::inverse_jacobian_coefficient(phi.squaredNorm()) * phi.cross(wt);
  r.tail<3>() = phi;
  return r;
}

/// Contribution of one factor to the linear system: blocks of H and of g.
struct Contribution {
  Matrix6d to_to, to_from, from_from;
  Vector6d g_to, g_from;
};

/// J_r⁻¹(r) = [a b; 0 a].
struct InverseJacobian {
  Eigen::Matrix3d a, b;
};

/// Coefficients of Q(ρ, φ) (Barfoot eq. 7.86b) as functions of θ².
struct CouplingCoefficients {
  double c1, c2, c3;
};

inline CouplingCoefficients coupling_coefficients(double t2) {
  if (t2 < 1.0) {
    // Σ (−θ²)ᵏ/(2k+3)!, Σ (−θ²)ᵏ/(2k+4)!, Σ (k+1)(−θ²)ᵏ/(2k+5)!: the first omitted term is below 1e-17.
    static constexpr double k1[] = {
        1.0 / 6,        1.0 / 120,        1.0 / 5040,          1.0 / 362880,
        1.0 / 39916800, 1.0 / 6227020800, 1.0 / 1307674368000, 1.0 / 355687428096000};
    static constexpr double k2[] = {
        1.0 / 24,        1.0 / 720,         1.0 / 40320,          1.0 / 3628800,
        1.0 / 479001600, 1.0 / 87178291200, 1.0 / 20922789888000, 1.0 / 6402373705728000};
    static constexpr double k3[] = {
        1.0 / 120,        2.0 / 5040,          3.0 / 362880,          4.0 / 39916800,
        5.0 / 6227020800, 6.0 / 1307674368000, 7.0 / 355687428096000, 8.0 / 121645100408832000.0};
    CouplingCoefficients c{k1[7], k2[7], k3[7]};
    for (int k = 6; k >= 0; --k) {
      c.c1 = k1[k] - t2 * c.c1;
      c.c2 = k2[k] - t2 * c.c2;
      c.c3 = k3[k] - t2 * c.c3;
    }
    return c;
  }
  const double t = std::sqrt(t2), sine = std::sin(t), cosine = std::cos(t);
  return {(t - sine) / (t2 * t), (0.5 * t2 + cosine - 1.0) / (t2 * t2),
          (2.0 * t + t * cosine - 3.0 * sine) / (2.0 * t2 * t2 * t)};
}

/// se3::right_jacobian_inverse without its matrix products: with d = φ·ρ, [φ][ρ][φ] = −d[φ] and
/// [φ]²[ρ] + [ρ][φ]² = −θ²[ρ] − d[φ], so Q is a skew matrix plus outer products.
inline InverseJacobian inverse_right_jacobian(const Eigen::Vector3d& rho, const Eigen::Vector3d& phi) {
  const double t2 = phi.squaredNorm(), d = phi.dot(rho);
  const Eigen::Matrix3d outer = phi * phi.transpose();
  const Eigen::Matrix3d square = outer - t2 * Eigen::Matrix3d::Identity();  // [φ]²
  InverseJacobian j;
  j.a = Eigen::Matrix3d::Identity() + 0.5 * se3::skew(phi) +
        se3::detail::inverse_jacobian_coefficient(t2) * square;
  const CouplingCoefficients c = coupling_coefficients(t2);
  const Eigen::Matrix3d mixed = rho * phi.transpose();
  // Q(−ρ, −φ): the skew part changes its sign, d and the outer products do not.
  Eigen::Matrix3d Q = c.c1 * (mixed + mixed.transpose()) - 2.0 * c.c3 * d * square;
  Q.diagonal().array() -= 2.0 * c.c1 * d;
  Q -= se3::skew((0.5 - c.c2 * t2) * rho + (2.0 * c.c2 - c.c1) * d * phi);
  j.b = -(j.a * Q * j.a);
  return j;
}

/// With J_to = J_r⁻¹(r) =: [a b; 0 a] and J_from = −J_to Ad(E), E = T_to⁻¹ T_from, all blocks follow from A =
/// J_toᵀ wΩ J_to and B = A Ad(E). They are computed from 3×3 products, because half of the blocks of every
/// factor are zero or repeated.
inline void linearize_factor(const Vector6d& r, const Pose& e, const Matrix6d& information, double weight,
                             bool both, Contribution& out) {
  const Eigen::Vector3d rho = r.head<3>(), phi = r.tail<3>();
  const InverseJacobian j = inverse_right_jacobian(rho, phi);
  const Eigen::Matrix3d &a = j.a, &b = j.b;
  const Eigen::Matrix3d o11 = weight * information.topLeftCorner<3, 3>();
  const Eigen::Matrix3d o12 = weight * information.topRightCorner<3, 3>();
  const Eigen::Matrix3d o22 = weight * information.bottomRightCorner<3, 3>();

  const Eigen::Matrix3d oa11 = o11 * a;
  const Eigen::Matrix3d oa12 = o11 * b + o12 * a;
  const Eigen::Matrix3d oa22 = o12.transpose() * b + o22 * a;
  const Eigen::Matrix3d a11 = a.transpose() * oa11;
  const Eigen::Matrix3d a12 = a.transpose() * oa12;
  const Eigen::Matrix3d a22 = b.transpose() * oa12 + a.transpose() * oa22;
  out.to_to.topLeftCorner<3, 3>() = a11;
  out.to_to.topRightCorner<3, 3>() = a12;
  out.to_to.bottomLeftCorner<3, 3>() = a12.transpose();
  out.to_to.bottomRightCorner<3, 3>() = a22;

  const Eigen::Vector3d u = o11 * rho + o12 * phi, v = o12.transpose() * rho + o22 * phi;
  const Eigen::Vector3d g_t = a.transpose() * u, g_r = b.transpose() * u + a.transpose() * v;
  out.g_to.head<3>() = g_t;
  out.g_to.tail<3>() = g_r;
  if (!both) return;

  const Eigen::Matrix3d& R = e.R;
  const Eigen::Matrix3d tR = se3::skew(e.t) * R;
  const Eigen::Matrix3d b11 = a11 * R, b12 = a11 * tR + a12 * R;
  const Eigen::Matrix3d b21 = a12.transpose() * R, b22 = a12.transpose() * tR + a22 * R;
  out.to_from.topLeftCorner<3, 3>() = -b11;
  out.to_from.topRightCorner<3, 3>() = -b12;
  out.to_from.bottomLeftCorner<3, 3>() = -b21;
  out.to_from.bottomRightCorner<3, 3>() = -b22;
  const Eigen::Matrix3d c11 = R.transpose() * b11, c12 = R.transpose() * b12;
  const Eigen::Matrix3d c22 = tR.transpose() * b12 + R.transpose() * b22;
  out.from_from.topLeftCorner<3, 3>() = c11;
  out.from_from.topRightCorner<3, 3>() = c12;
  out.from_from.bottomLeftCorner<3, 3>() = c12.transpose();
  out.from_from.bottomRightCorner<3, 3>() = c22;
  out.g_from.head<3>() = -(R.transpose() * g_t);
  out.g_from.tail<3>() = -(tR.transpose() * g_t + R.transpose() * g_r);
}

/// Gradient of one factor with respect to the poses of its two ends.
struct FactorGradient {
  Vector6d to = Vector6d::Zero(), from = Vector6d::Zero();
};

/// The gradient of linearize_factor(), without the blocks of the Hessian. Transposes of the blocks of J_r⁻¹
/// are applied to vectors: aᵀv = v − ½ φ×v + k φ×(φ×v), and b = −a Q a.
inline FactorGradient factor_gradient(const Vector6d& r, const Pose& e, const Matrix6d& information,
                                      double weight) {
  const Eigen::Vector3d rho = r.head<3>(), phi = r.tail<3>();
  const double t2 = phi.squaredNorm(), d = phi.dot(rho);
  const double k = se3::detail::inverse_jacobian_coefficient(t2);
  const CouplingCoefficients c = coupling_coefficients(t2);
  const auto times_a = [&](const Eigen::Vector3d& v) {
    const Eigen::Vector3d turned = phi.cross(v);
    return Eigen::Vector3d(v - 0.5 * turned + k * phi.cross(turned));
  };
  const Eigen::Vector3d axis = (0.5 - c.c2 * t2) * rho + (2.0 * c.c2 - c.c1) * d * phi;
  const auto times_q = [&](const Eigen::Vector3d& v) {
    return Eigen::Vector3d(c.c1 * (phi.dot(v) * rho + rho.dot(v) * phi - 2.0 * d * v) -
                           2.0 * c.c3 * d * phi.cross(phi.cross(v)) + axis.cross(v));
  };
  const Vector6d weighted = weight * (information * r);
  const Eigen::Vector3d g_t = times_a(weighted.head<3>());
  const Eigen::Vector3d g_r = times_a(weighted.tail<3>() - times_q(g_t));
  FactorGradient out;
  out.to << g_t, g_r;
  out.from << -(e.R.transpose() * g_t), -(e.R.transpose() * (g_r - e.t.cross(g_t)));
  return out;
}

/// T ⊕ xi; the rotation stays orthogonal.
template <class Vector>
Pose moved_by(const Pose& pose, const Eigen::MatrixBase<Vector>& xi) {
  const Eigen::Vector3d phi = xi.template tail<3>();
  Pose out;
  out.t = pose.t + pose.R * (se3::so3_left_jacobian(phi) * xi.template head<3>());
  // One step of Newton's iteration for the polar factor prevents an accumulation of rounding errors.
  const Eigen::Matrix3d R = pose.R * se3::so3_exp(phi);
  out.R = 1.5 * R - 0.5 * R * (R.transpose() * R);
  return out;
}

}  // namespace loopwise::detail
