// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/se3.hpp>

#include <cmath>
#include <limits>

namespace loopwise::se3 {

Eigen::Matrix3d so3_exp(const Eigen::Vector3d& phi) {
  const auto k = detail::exp_coefficients(phi.squaredNorm());
  const Eigen::Matrix3d w = skew(phi);
  return Eigen::Matrix3d::Identity() + k.a * w + k.b * (w * w);
}

Eigen::Vector3d so3_log(const Eigen::Matrix3d& R) {
  // Through the quaternion: no cancellation near 0 (vector part) nor near π (scalar part).
  Eigen::Quaterniond q(R);
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const double n2 = q.vec().squaredNorm();
  if (n2 < 1e-14) return (2.0 / q.w() - 2.0 / 3.0 * n2 / (q.w() * q.w() * q.w())) * q.vec();
  const double n = std::sqrt(n2);
  return (2.0 * std::atan2(n, q.w()) / n) * q.vec();
}

Eigen::Matrix3d so3_left_jacobian(const Eigen::Vector3d& phi) {
  const auto k = detail::exp_coefficients(phi.squaredNorm());
  const Eigen::Matrix3d w = skew(phi);
  return Eigen::Matrix3d::Identity() + k.b * w + k.c * (w * w);
}

Eigen::Matrix3d so3_left_jacobian_inverse(const Eigen::Vector3d& phi) {
  const Eigen::Matrix3d w = skew(phi);
  return Eigen::Matrix3d::Identity() - 0.5 * w +
         detail::inverse_jacobian_coefficient(phi.squaredNorm()) * (w * w);
}

Eigen::Isometry3d exp(const Vector6d& xi) {
  const Eigen::Vector3d phi = xi.tail<3>();
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = so3_exp(phi);
  T.translation() = so3_left_jacobian(phi) * xi.head<3>();
  return T;
}

Vector6d log(const Eigen::Isometry3d& T) {
  Vector6d xi;
  xi.tail<3>() = so3_log(T.linear());
  xi.head<3>() = so3_left_jacobian_inverse(xi.tail<3>()) * T.translation();
  return xi;
}

Matrix6d adjoint(const Eigen::Isometry3d& T) {
  Matrix6d ad;
  ad.topLeftCorner<3, 3>() = T.linear();
  ad.topRightCorner<3, 3>() = skew(T.translation()) * T.linear();
  ad.bottomLeftCorner<3, 3>().setZero();
  ad.bottomRightCorner<3, 3>() = T.linear();
  return ad;
}

namespace {

/// Q(ρ, φ), the coupling of translation and rotation in SE(3)'s left Jacobian (Barfoot eq. 7.86b).
Eigen::Matrix3d jacobian_coupling(const Eigen::Vector3d& rho, const Eigen::Vector3d& phi) {
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

}  // namespace

Matrix6d left_jacobian(const Vector6d& xi) {
  const Eigen::Vector3d rho = xi.head<3>(), phi = xi.tail<3>();
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = J.bottomRightCorner<3, 3>() = so3_left_jacobian(phi);
  J.topRightCorner<3, 3>() = jacobian_coupling(rho, phi);
  return J;
}

Matrix6d left_jacobian_inverse(const Vector6d& xi) {
  const Eigen::Vector3d rho = xi.head<3>(), phi = xi.tail<3>();
  const Eigen::Matrix3d j = so3_left_jacobian_inverse(phi);
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = J.bottomRightCorner<3, 3>() = j;
  J.topRightCorner<3, 3>() = -j * jacobian_coupling(rho, phi) * j;
  return J;
}

Matrix6d right_jacobian(const Vector6d& xi) {
  return left_jacobian(-xi);
}

Matrix6d right_jacobian_inverse(const Vector6d& xi) {
  return left_jacobian_inverse(-xi);
}

Matrix6d swap_tangent_order(const Matrix6d& m) {
  Matrix6d out;
  out.topLeftCorner<3, 3>() = m.bottomRightCorner<3, 3>();
  out.topRightCorner<3, 3>() = m.bottomLeftCorner<3, 3>();
  out.bottomLeftCorner<3, 3>() = m.topRightCorner<3, 3>();
  out.bottomRightCorner<3, 3>() = m.topLeftCorner<3, 3>();
  return out;
}

Matrix6d covariance_of_inverse(const Eigen::Isometry3d& T, const Matrix6d& covariance) {
  const Matrix6d ad = adjoint(T);
  const Matrix6d moved = ad * covariance * ad.transpose();
  return 0.5 * (moved + moved.transpose());
}

Eigen::Isometry3d normalized(const Eigen::Isometry3d& T) {
  Eigen::Isometry3d out = T;
  out.linear() = Eigen::Quaterniond(T.linear()).normalized().toRotationMatrix();
  return out;
}

double rotation_defect(const Eigen::Matrix3d& R) {
  const Eigen::Matrix3d off = R * R.transpose() - Eigen::Matrix3d::Identity();
  if (!off.allFinite() || R.determinant() < 0.0) return std::numeric_limits<double>::infinity();
  return off.cwiseAbs().maxCoeff();
}

double rotation_angle(const Eigen::Isometry3d& T) {
  return so3_log(T.linear()).norm();
}

}  // namespace loopwise::se3
