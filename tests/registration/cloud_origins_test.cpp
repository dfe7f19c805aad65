// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/cloud_origins.hpp>

#include "testing.hpp"

namespace loopwise::cloud_origins_test {
namespace {

const CloudOrigins kFar = {{432100.0, 5432110.0, 30.0}, {432150.0, 5432090.0, 28.0}};

/// Maps a point of the source as the pose about these origins says.
Eigen::Vector3d mapped(const CloudOrigins& origins, const Eigen::Isometry3d& T, const Eigen::Vector3d& p) {
  return T * (p - origins.source) + origins.target;
}

}  // namespace

TEST_CASE("cloud origins: a pose about other points maps the same points", "[registration][origin]") {
  Rng rng(7);
  const Eigen::Isometry3d T = testing::random_pose(rng);
  const Eigen::Vector3d p = kFar.source + Eigen::Vector3d(3.0, -20.0, 1.5);
  const CloudOrigins common = origins_to_report(kFar), files;
  REQUIRE(common.target == kFar.target);
  REQUIRE(common.source == kFar.target);
  REQUIRE(files.zero());
  REQUIRE_FALSE(common.zero());
  for (const CloudOrigins& other : {common, files}) {
    const Eigen::Isometry3d converted = other.pose_from(kFar, T);
    // The bound is above the rounding of doubles at 5000 km, 1e-9 m; a wrong sign is off by metres.
    REQUIRE((mapped(other, converted, p) - mapped(kFar, T, p)).norm() < 1e-7);
    REQUIRE(testing::difference(kFar.pose_from(other, converted), T) < 1e-7);
  }
}

TEST_CASE("cloud origins: clouds in different coordinates keep their own points", "[registration][origin]") {
  const CloudOrigins apart = {{0.0, 0.0, 0.0}, {432150.0, 5432090.0, 28.0}};
  REQUIRE(origins_to_report(apart).target == apart.target);
  REQUIRE(origins_to_report(apart).source == apart.source);
}

TEST_CASE("cloud origins: the covariance is that of the converted pose", "[registration][origin]") {
  Rng rng(8);
  const Eigen::Isometry3d T = testing::random_pose(rng);
  const CloudOrigins here = {{1.0, 2.0, 3.0}, {4.0, -5.0, 6.0}}, there = {{-2.0, 0.5, 1.0}, {3.0, 3.0, -1.0}};
  const Matrix6d root = Matrix6d::Random(), covariance = root * root.transpose();
  const Matrix6d converted = there.covariance_from(here, covariance);
  // T · Exp(ξ) about `here` is converted(T) · Exp(J ξ) about `there`: J by differences of the converted pose.
  constexpr double kStep = 1e-6;
  Matrix6d J;
  for (int axis = 0; axis < 6; ++axis) {
    const Vector6d step = kStep * Vector6d::Unit(axis);
    J.col(axis) =
        se3::log(there.pose_from(here, T).inverse() * there.pose_from(here, T * se3::exp(step))) / kStep;
  }
  REQUIRE((J * covariance * J.transpose() - converted).cwiseAbs().maxCoeff() < 1e-4 * converted.norm());
}

TEST_CASE("cloud origins: a transformed cloud has moved points and normals", "[registration][origin]") {
  PointCloud cloud;
  cloud.points = {{1.0F, 0.0F, 0.0F}, {0.0F, 2.0F, 0.0F}};
  cloud.normals = {{1.0F, 0.0F, 0.0F}, {0.0F, 1.0F, 0.0F}};
  cloud.intensities = {5.0F, 6.0F};
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = se3::so3_exp({0.0, 0.0, 1.5707963267948966});
  T.translation() << 10.0, 0.0, 0.0;
  const PointCloud moved = transformed(cloud, T, {7.0, 8.0, 9.0});
  REQUIRE(moved.origin == Eigen::Vector3d(7.0, 8.0, 9.0));
  REQUIRE((moved.points[0] - Eigen::Vector3f(10.0F, 1.0F, 0.0F)).norm() < 1e-5F);
  REQUIRE((moved.points[1] - Eigen::Vector3f(8.0F, 0.0F, 0.0F)).norm() < 1e-5F);
  REQUIRE((moved.normals[0] - Eigen::Vector3f(0.0F, 1.0F, 0.0F)).norm() < 1e-5F);
  REQUIRE(moved.intensities == cloud.intensities);
}

}  // namespace loopwise::cloud_origins_test
