// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The registrar `icp`, the way of open SLAM programs.
#include <memory>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/registration/icp_registrar.hpp>
#include "scene.hpp"
#include "testing.hpp"

namespace loopwise::icp_registrar_test {
namespace {

/// A yard seen from two poses; key 1 is the newer node.
struct Pair {
  testing::Scans scans;
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();

  explicit Pair(std::uint64_t seed, std::size_t points = 6000) {
    const testing::Scene scene(seed);
    Rng rng(seed);
    const Eigen::Isometry3d old_pose = testing::ground_pose(0.0, 0.0, 0.0),
                            new_pose = testing::ground_pose(1.0, -0.5, 0.1);
    scans[0] = scene.scan(old_pose, points, rng, 0.01);
    scans[1] = scene.scan(new_pose, points, rng, 0.01);
    T_from_to = new_pose.inverse() * old_pose;
  }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task,
                                           const IcpRegistrarOptions& options = {}) const {
    return IcpRegistrar(std::make_shared<FeatureCache>(testing::loader(scans)), options).compute(task);
  }
};

TEST_CASE("icp: descends from a near guess to the pose", "[registrar]") {
  for (const std::uint64_t seed : {1, 2, 3, 4, 5}) {
    const Pair pair(seed);
    RegistrationTask task = pair_task(1, 0, 1);
    task.guess_from_to =
        pair.T_from_to * se3::exp((Vector6d() << 0.2, -0.2, 0.1, 0.01, 0.0, 0.03).finished());
    IcpRegistrarOptions near;  // with the default reach, points that only one scan has pull it aside
    near.max_correspondence_m = 1.0;
    const RegistrationResult result = pair.compute(task, near);
    CAPTURE(seed, result.message);
    REQUIRE(result.verified());
    const Eigen::Isometry3d error = pair.T_from_to.inverse() * result.closure->T_from_to;
    CHECK(error.translation().norm() < 0.2);  // measured at most 0.13 m; the guess is 0.3 m off
    CHECK(se3::rotation_angle(error) < 0.01);
    CHECK(result.closure->from == 1);
    CHECK(result.closure->to == 0);
    CHECK(result.closure->covariance.isApprox(0.49 * Matrix6d::Identity()));
    CHECK(pair.compute(task, near).T_from_to->matrix() == result.T_from_to->matrix());
  }
}

TEST_CASE("icp: judges by the mean squared distance of all points alone", "[registrar]") {
  const Pair pair(6);
  RegistrationTask task = pair_task(1, 0, 1);
  task.guess_from_to = pair.T_from_to;
  const RegistrationResult near = pair.compute(task);
  REQUIRE(near.verified());
  IcpRegistrarOptions strict;
  strict.max_fitness_m2 = 0.9 * near.gicp_fitness_m2;
  const RegistrationResult refused = pair.compute(task, strict);
  CHECK(refused.reason == RejectionReason::kGicpFitness);
  CHECK_THAT(refused.message, Contains("must be <="));

  // One point in a hundred, 60 m away: matched by none within a metre, but it counts in the mean.
  auto stretched = std::make_shared<PointCloud>(*pair.scans.at(1));
  for (std::size_t i = 0; i < stretched->size() / 100; ++i) {
    stretched->points.push_back({60.0F + 0.1F * static_cast<float>(i), 0.0F, 30.0F});
  }
  Pair with_far = pair;
  with_far.scans[1] = stretched;
  IcpRegistrarOptions reach_of_a_metre;
  reach_of_a_metre.max_correspondence_m = 1.0;
  const RegistrationResult far = with_far.compute(task, reach_of_a_metre);
  CHECK(far.reason == RejectionReason::kGicpFitness);
  CHECK(far.gicp_fitness_m2 > 5.0);
}

TEST_CASE("icp: scans without points, or without matches, are refused", "[registrar][error]") {
  Pair pair(7);
  pair.scans[2] = std::make_shared<PointCloud>();
  CHECK(pair.compute(pair_task(2, 0, 1)).reason == RejectionReason::kTooFewPoints);
  CHECK(pair.compute(pair_task(1, 2, 1)).reason == RejectionReason::kTooFewPoints);
  CHECK(pair.compute(pair_task(1, 9, 1)).reason == RejectionReason::kMissingScan);
  RegistrationTask away = pair_task(1, 0, 1);
  away.guess_from_to = Eigen::Isometry3d(Eigen::Translation3d(500.0, 0.0, 0.0));
  CHECK(pair.compute(away).reason == RejectionReason::kTooFewPoints);
  RegistrationTask late = pair_task(1, 0, 1);
  late.time_limit_s = 1e-9;
  CHECK(pair.compute(late).reason == RejectionReason::kTimeLimit);
}

TEST_CASE("icp: options are checked", "[registrar][error]") {
  const auto features = std::make_shared<FeatureCache>(testing::loader({}));
  IcpRegistrarOptions options;
  options.iterations = 0;
  REQUIRE_THROWS_WITH(IcpRegistrar(features, options), "iterations = 0, must be >= 1");
  REQUIRE_THROWS_AS(IcpRegistrar(nullptr), InputError);
}

}  // namespace
}  // namespace loopwise::icp_registrar_test
