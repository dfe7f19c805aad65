// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <Eigen/LU>

#include <loopwise/core/se3.hpp>

#include "testing.hpp"

namespace loopwise::se3_test {
namespace {

using testing::difference;
using testing::random_pose;

constexpr double kPi = 3.14159265358979323846;

/// Twists that reach every branch: the identity, tiny, small, around the series' limits, large, and close to
/// π.
std::vector<Vector6d> twists() {
  std::vector<Vector6d> all{Vector6d::Zero()};
  Rng rng(1);
  for (const double angle :
       {1e-12, 1e-7, 1e-4, 0.0999, 0.1001, 0.5, 0.999, 1.001, 2.0, 3.0, kPi - 1e-3, kPi - 1e-7}) {
    for (int i = 0; i < 8; ++i) {
      Vector6d xi;
      for (int k = 0; k < 6; ++k) xi[k] = rng.normal();
      xi.tail<3>() = xi.tail<3>().normalized() * angle;
      if (i == 0) xi.head<3>() *= 1e5;
      all.push_back(xi);
    }
  }
  return all;
}

/// Exp from its definition, by scaling and squaring of the 4×4 matrix series: slow and independent.
Eigen::Matrix4d exp_by_series(const Vector6d& xi) {
  Eigen::Matrix4d a = Eigen::Matrix4d::Zero();
  a.topLeftCorner<3, 3>() = se3::skew(xi.tail<3>());
  a.topRightCorner<3, 1>() = xi.head<3>();
  a /= 1024.0;
  Eigen::Matrix4d term = Eigen::Matrix4d::Identity(), sum = term;
  for (int n = 1; n < 20; ++n) {
    term = term * a / n;
    sum += term;
  }
  for (int n = 0; n < 10; ++n) sum = sum * sum;
  return sum;
}

}  // namespace

TEST_CASE("se3: exp equals the matrix exponential", "[core][se3]") {
  for (const Vector6d& xi : twists()) {
    CAPTURE(xi.transpose());
    const double scale = 1.0 + xi.norm();
    REQUIRE((se3::exp(xi).matrix() - exp_by_series(xi)).cwiseAbs().maxCoeff() < 1e-12 * scale);
  }
}

TEST_CASE("se3: log inverts exp", "[core][se3]") {
  for (const Vector6d& xi : twists()) {
    CAPTURE(xi.transpose());
    // Near π a rounding of the matrix moves the axis by its square root at worst; measured 3e-9 at π − 1e-7.
    const double tolerance = xi.tail<3>().norm() > 3.1 ? 1e-8 : 1e-12;
    REQUIRE((se3::log(se3::exp(xi)) - xi).norm() < tolerance * (1.0 + xi.norm()));
  }
}

TEST_CASE("se3: exp inverts log at a half turn", "[core][se3]") {
  for (const Eigen::Vector3d& axis : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0),
                                      Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(1, 2, -3).normalized()}) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = Eigen::AngleAxisd(kPi, axis).toRotationMatrix();
    T.translation() << 1, -2, 3;
    const Vector6d xi = se3::log(T);
    REQUIRE(xi.tail<3>().norm() == Approx(kPi).margin(1e-12));
    REQUIRE(difference(se3::exp(xi), T) < 1e-12);
  }
}

TEST_CASE("se3: the defect of a rotation measures rounding and scaling", "[core][se3]") {
  Rng rng(2);
  for (int i = 0; i < 20; ++i) {
    const Eigen::Matrix3d R = random_pose(rng).linear();
    CHECK(se3::rotation_defect(R) < 1e-14);
    CHECK(se3::rotation_defect(R.cast<float>().cast<double>()) < 1e-6);
    CHECK(se3::rotation_defect(1.001 * R) == Approx(2.001e-3).epsilon(1e-6));
    CHECK(std::isinf(se3::rotation_defect(-R)));
    CHECK(std::isinf(se3::rotation_defect(1e200 * R)));
    CHECK(std::isinf(se3::rotation_defect(std::nan("") * R)));
  }
}

TEST_CASE("se3: adjoint moves a twist to the other side", "[core][se3]") {
  Rng rng(2);
  for (int i = 0; i < 50; ++i) {
    const Eigen::Isometry3d T = random_pose(rng, 5.0);
    const Vector6d xi = se3::log(random_pose(rng));
    REQUIRE(difference(T * se3::exp(xi) * T.inverse(), se3::exp(se3::adjoint(T) * xi)) < 1e-10);
  }
}

TEST_CASE("se3: Jacobians equal central differences", "[core][se3][jacobian]") {
  constexpr double h = 1e-5;
  for (const Vector6d& xi : twists()) {
    if (xi.norm() > 100.0) continue;  // the differences themselves lose their digits there
    CAPTURE(xi.transpose());
    const Matrix6d Jr = se3::right_jacobian(xi);
    const Matrix6d Jl = se3::left_jacobian(xi);
    Matrix6d numeric_r, numeric_l;
    const Eigen::Isometry3d T = se3::exp(xi);
    for (int k = 0; k < 6; ++k) {
      const Vector6d step = h * Vector6d::Unit(k);
      const Eigen::Isometry3d plus = se3::exp(xi + step), minus = se3::exp(xi - step);
      numeric_r.col(k) = (se3::log(T.inverse() * plus) - se3::log(T.inverse() * minus)) / (2 * h);
      numeric_l.col(k) = (se3::log(plus * T.inverse()) - se3::log(minus * T.inverse())) / (2 * h);
    }
    // Measured ≤ 3e-10; a wrong series coefficient shows as 1e-6 and more.
    REQUIRE((Jr - numeric_r).cwiseAbs().maxCoeff() < 1e-8);
    REQUIRE((Jl - numeric_l).cwiseAbs().maxCoeff() < 1e-8);
  }
}

TEST_CASE("se3: inverse Jacobians invert, also at large translations", "[core][se3][jacobian]") {
  for (const Vector6d& xi : twists()) {
    CAPTURE(xi.transpose());
    const double scale = 1.0 + xi.head<3>().norm();
    REQUIRE((se3::right_jacobian(xi) * se3::right_jacobian_inverse(xi) - Matrix6d::Identity())
                .cwiseAbs()
                .maxCoeff() < 1e-11 * scale);
    REQUIRE((se3::left_jacobian_inverse(xi) * se3::left_jacobian(xi) - Matrix6d::Identity())
                .cwiseAbs()
                .maxCoeff() < 1e-11 * scale);
  }
}

TEST_CASE("se3: the edge residual's Jacobians equal central differences", "[core][se3][jacobian]") {
  Rng rng(3);
  constexpr double h = 1e-6;
  for (int i = 0; i < 30; ++i) {
    const Eigen::Isometry3d Ti = random_pose(rng, 3.0), Tj = random_pose(rng, 3.0);
    const Eigen::Isometry3d Z = Ti.inverse() * Tj * se3::exp(0.3 * se3::log(random_pose(rng)));
    const auto residual = [&Z](const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
      return se3::log(Z.inverse() * a.inverse() * b);
    };
    const Vector6d r = residual(Ti, Tj);
    const Matrix6d Jj = se3::right_jacobian_inverse(r);
    const Matrix6d Ji = -Jj * se3::adjoint(Tj.inverse() * Ti);
    for (int k = 0; k < 6; ++k) {
      const Eigen::Isometry3d p = se3::exp(h * Vector6d::Unit(k)), m = se3::exp(-h * Vector6d::Unit(k));
      REQUIRE(((residual(Ti * p, Tj) - residual(Ti * m, Tj)) / (2 * h) - Ji.col(k)).norm() <
              1e-7 * (1 + Ji.norm()));
      REQUIRE(((residual(Ti, Tj * p) - residual(Ti, Tj * m)) / (2 * h) - Jj.col(k)).norm() <
              1e-7 * (1 + Jj.norm()));
    }
  }
}

TEST_CASE("se3: the covariance of the inverse follows samples", "[core][se3]") {
  Rng rng(4);
  const Eigen::Isometry3d T = random_pose(rng, 4.0);
  Matrix6d L = Matrix6d::Zero();
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c <= r; ++c) L(r, c) = 1e-4 * rng.normal();
  }
  // To first order each sample ξ of T moves T⁻¹ by η = Log(T · (T·Exp(ξ))⁻¹), so the columns of L may stand
  // for samples.
  Matrix6d moved;
  for (int k = 0; k < 6; ++k) moved.col(k) = se3::log(T * (T * se3::exp(L.col(k))).inverse());
  const Matrix6d expected = moved * moved.transpose();
  const Matrix6d found = se3::covariance_of_inverse(T, L * L.transpose());
  REQUIRE((found - expected).cwiseAbs().maxCoeff() < 1e-3 * expected.cwiseAbs().maxCoeff());
}

TEST_CASE("se3: swapping the tangent order twice changes nothing", "[core][se3]") {
  Matrix6d m;
  for (int i = 0; i < 36; ++i) m(i / 6, i % 6) = i;
  REQUIRE(se3::swap_tangent_order(m)(0, 0) == m(3, 3));
  REQUIRE(se3::swap_tangent_order(m)(0, 4) == m(3, 1));
  REQUIRE(se3::swap_tangent_order(se3::swap_tangent_order(m)) == m);
}

}  // namespace loopwise::se3_test
