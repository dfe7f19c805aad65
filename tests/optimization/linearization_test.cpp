// SPDX-License-Identifier: BSD-3-Clause
#include "linearization.hpp"

#include <catch2/catch.hpp>

#include <cmath>

#include "support.hpp"

namespace loopwise::linearization_test {
namespace {

using namespace loopwise::testing;

Vector6d random_tangent(Rng& rng, double rotation) {
  Vector6d xi;
  for (Eigen::Index i = 0; i < 6; ++i) xi[i] = rng.normal();
  xi.tail<3>() *= rotation / xi.tail<3>().norm();
  return xi;
}

detail::Pose pose_of(const Eigen::Isometry3d& T) {
  detail::Pose pose;
  pose.R = T.linear();
  pose.t = T.translation();
  return pose;
}

}  // namespace

TEST_CASE("linearisation: the gradient alone is that of the blocks", "[optimization][property]") {
  Rng rng(81);
  for (const double angle : {1e-9, 1e-3, 0.1, 0.5, 1.5, 3.1}) {
    CAPTURE(angle);
    for (int round = 0; round < 20; ++round) {
      const Vector6d r = random_tangent(rng, angle);
      const detail::Pose e = pose_of(se3::exp(random_tangent(rng, 1.0)));
      Matrix6d root;
      for (Eigen::Index i = 0; i < root.size(); ++i) root.data()[i] = rng.normal();
      const Matrix6d information = root * root.transpose();
      detail::Contribution blocks;
      detail::linearize_factor(r, e, information, 0.7, true, blocks);
      const detail::FactorGradient gradient = detail::factor_gradient(r, e, information, 0.7);
      const double unit = std::max(blocks.g_to.norm(), blocks.g_from.norm());
      REQUIRE((gradient.to - blocks.g_to).norm() < 1e-13 * unit);
      REQUIRE((gradient.from - blocks.g_from).norm() < 1e-13 * unit);
    }
  }
}

TEST_CASE("linearisation: the series of the logarithm has the precision of a double",
          "[optimization][property]") {
  Rng rng(82);
  // The series ends near 0.2 rad.
  for (const double angle : {0.0, 1e-300, 1e-12, 1e-6, 0.01, 0.1, 0.19, 0.1999, 0.2001, 0.3, 3.0}) {
    CAPTURE(angle);
    const Eigen::Vector3d axis = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
    const Eigen::Vector3d phi = detail::rotation_vector(se3::so3_exp(angle * axis));
    REQUIRE((phi - angle * axis).norm() <= 1e-15 * angle);
  }
}

}  // namespace loopwise::linearization_test
