// SPDX-License-Identifier: BSD-3-Clause
// Included first and without other headers of the library: it must be self-contained.
#include <loopwise/registration/align.hpp>

#include <limits>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/registration/registrar.hpp>

#include "scene.hpp"
#include "testing.hpp"

namespace other {

/// As point types of other libraries: more fields, and padding.
struct PointXYZI {
  float x, y, z, padding, intensity;
};

/// A cloud of somebody else, without operator[].
struct Sweep {
  std::vector<double> xyz;
};

}  // namespace other

namespace loopwise {

template <>
struct PointCloudTraits<other::Sweep> {
  static std::size_t size(const other::Sweep& sweep) { return sweep.xyz.size() / 3; }
  static Eigen::Vector3d point(const other::Sweep& sweep, std::size_t i) {
    return Eigen::Map<const Eigen::Vector3d>(sweep.xyz.data() + 3 * i);
  }
};

}  // namespace loopwise

namespace loopwise::align_test {

namespace {

using Catch::Matchers::Contains;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Two scans of one place, and the motion between them.
struct Pair {
  PointCloud target, source;
  Eigen::Isometry3d T_target_source;
};

Pair two_scans() {
  const testing::Scene scene(3);
  Rng rng(4);
  const Eigen::Isometry3d T_w_target = testing::ground_pose(0.0, 0.0, 0.1);
  const Eigen::Isometry3d T_w_source = testing::ground_pose(1.5, -0.7, 0.5);
  return {*scene.scan(T_w_target, 6000, rng), *scene.scan(T_w_source, 6000, rng),
          T_w_target.inverse() * T_w_source};
}

template <class Other>
std::vector<Other> converted(const PointCloud& cloud) {
  std::vector<Other> out;
  for (const Eigen::Vector3f& p : cloud.points) out.push_back({p.x(), p.y(), p.z(), 0.0F, 7.0F});
  return out;
}

void require_same(const AlignResult& a, const AlignResult& b) {
  REQUIRE(a.success == b.success);
  REQUIRE(a.T_target_source.matrix() == b.T_target_source.matrix());  // every bit
  REQUIRE(a.covariance == b.covariance);
  REQUIRE(a.inlier_share == b.inlier_share);
}

}  // namespace

TEST_CASE("align: finds the transform from source to target", "[registration][align]") {
  const Pair pair = two_scans();
  const AlignResult result = align(pair.target, pair.source);
  CAPTURE(result.message);
  REQUIRE(result.success);
  REQUIRE(result.reason == RejectionReason::kNone);
  // Measured: 0.019 m and 0.0009 rad. The inverse would be 3 m away.
  const Vector6d error = se3::log(pair.T_target_source.inverse() * result.T_target_source);
  CHECK(error.head<3>().norm() < 0.05);
  CHECK(error.tail<3>().norm() < 0.01);
  CHECK(result.inlier_share > 0.5);
  CHECK(result.inlier_share <= 1.0);
  CHECK(result.dropped_target_points == 0);

  // Transform and covariance are those of the registrar, the other way round.
  const auto scans = testing::loader(
      {{1, std::make_shared<PointCloud>(pair.source)}, {0, std::make_shared<PointCloud>(pair.target)}});
  const RegistrationResult same =
      FastRegistrar(std::make_shared<FeatureCache>(scans)).compute(pair_task(1, 0, 1));
  REQUIRE(same.verified());
  REQUIRE(result.T_target_source.isApprox(same.closure->T_from_to.inverse()));
  const Matrix6d back = se3::covariance_of_inverse(result.T_target_source, result.covariance);
  REQUIRE(back.isApprox(same.closure->covariance, 1e-9));
}

TEST_CASE("align: every kind of cloud gives the same bits", "[registration][align]") {
  const Pair pair = two_scans();
  const AlignResult expected = align(pair.target, pair.source);
  require_same(expected, align(pair.target.points, pair.source.points));
  require_same(expected, align(converted<other::PointXYZI>(pair.target), pair.source));
  const auto columns = [](const PointCloud& cloud) {
    return Eigen::Map<const Eigen::Matrix3Xf>(cloud.points.front().data(), 3,
                                              static_cast<Eigen::Index>(cloud.size()));
  };
  const Eigen::Matrix3Xf single = columns(pair.target);
  const Eigen::MatrixXd dynamic = columns(pair.source).cast<double>();
  require_same(expected, align(single, dynamic));
  require_same(expected, align(columns(pair.target), columns(pair.source)));
  other::Sweep sweep;
  for (const Eigen::Vector3f& p : pair.source.points) {
    for (int axis = 0; axis < 3; ++axis) sweep.xyz.push_back(static_cast<double>(p[axis]));
  }
  require_same(expected, align(pair.target, sweep));
  // An origin belongs to the points.
  PointCloud shifted = pair.source;
  shifted.origin = Eigen::Vector3d(8.0, 0.0, 0.0);
  for (Eigen::Vector3f& p : shifted.points) p.x() -= 8.0F;
  const AlignResult moved = align(pair.target, shifted);
  REQUIRE(moved.success);
  REQUIRE(moved.T_target_source.isApprox(expected.T_target_source, 0.01));  // points are rounded again
}

TEST_CASE("align: points that are not finite are dropped and counted", "[registration][align]") {
  const Pair pair = two_scans();
  const AlignResult expected = align(pair.target, pair.source);
  PointCloud holes = pair.source;
  holes.points.insert(holes.points.begin() + 5, Eigen::Vector3f(kNan, 0.0F, 0.0F));
  holes.points.insert(holes.points.begin() + 50,
                      Eigen::Vector3f(0.0F, std::numeric_limits<float>::infinity(), 0.0F));
  holes.points.emplace_back(1e4F, 0.0F, 0.0F);  // beyond FeatureOptions::max_range_m
  const AlignResult result = align(pair.target, holes);
  require_same(expected, result);
  REQUIRE(result.dropped_source_points == 3);
  REQUIRE(result.dropped_target_points == 0);
}

TEST_CASE("align: a guess leads from source to target", "[registration][align]") {
  const Pair pair = two_scans();
  AlignOptions options;
  options.guess = pair.T_target_source;
  REQUIRE(align(pair.target, pair.source, options).success);
  // A result too far from the guess is rejected, so the direction of the guess matters.
  options.registration.tests.max_translation_m = 1.0;
  REQUIRE(align(pair.target, pair.source, options).success);
  options.guess = pair.T_target_source.inverse();
  const AlignResult wrong = align(pair.target, pair.source, options);
  REQUIRE_FALSE(wrong.success);
  options.guess->linear() *= 2.0;
  REQUIRE_THROWS_WITH(align(pair.target, pair.source, options),
                      Contains("the guess is not a rigid transform"));
}

TEST_CASE("align: clouds that cannot be aligned give a reason and no transform",
          "[registration][align][error]") {
  const Pair pair = two_scans();
  const AlignResult none = align(pair.target, std::vector<Eigen::Vector3f>());
  REQUIRE_FALSE(none.success);
  REQUIRE(none.reason == RejectionReason::kTooFewPoints);
  REQUIRE_FALSE(none.message.empty());
  REQUIRE(none.T_target_source.matrix().topRows<3>().array().isNaN().all());
  REQUIRE(none.covariance.array().isNaN().all());

  REQUIRE_THROWS_WITH(align(Eigen::MatrixXf(Eigen::MatrixXf::Zero(100, 3)), pair.source),
                      Contains("found 100 rows"));
  std::vector<Eigen::Vector3d> far;
  for (const Eigen::Vector3f& p : pair.source.points)
    far.push_back(p.cast<double>() + Eigen::Vector3d(5e5, 4e6, 0.0));
  REQUIRE_THROWS_WITH(align(pair.target, far), Contains("source is in world coordinates"));
  AlignOptions options;
  options.features.voxel_m = -1.0;
  REQUIRE_THROWS_AS(align(pair.target, pair.source, options), OptionError);
  options = {};
  options.time_limit_s = -1.0;
  REQUIRE_THROWS_WITH(align(pair.target, pair.source, options), Contains("time_limit_s"));
}

}  // namespace loopwise::align_test
