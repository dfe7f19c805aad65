// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/closure_statistics.hpp>

#include "testing.hpp"

namespace loopwise::closure_statistics_test {
namespace {

/// Five nodes 2 m apart that turn by 0.3 rad a step.
PosesByKey curve() {
  PosesByKey truth;
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Vector6d step;
  step << 2.0, 0.0, 0.1, 0.0, 0.0, 0.3;
  for (Key key = 0; key < 5; ++key) {
    truth[key] = pose;
    pose = pose * se3::exp(step);
  }
  return truth;
}

RegistrationResult verified(const PosesByKey& truth, Key from, Key to, const Eigen::Isometry3d& error) {
  RegistrationResult result;
  result.candidate.from = from;
  result.candidate.to = to;
  LoopClosure closure;
  closure.from = from;
  closure.to = to;
  const auto at = [&](Key key) { return truth.count(key) ? truth.at(key) : Eigen::Isometry3d::Identity(); };
  closure.T_from_to = at(from).inverse() * at(to) * error;
  result.closure = closure;
  return result;
}

RegistrationResult rejected(RejectionReason reason) {
  RegistrationResult result;
  result.reason = reason;
  return result;
}

Eigen::Isometry3d error_of(double translation_m, double rotation_rad) {
  Eigen::Isometry3d error = Eigen::Isometry3d::Identity();
  error.linear() = se3::so3_exp(rotation_rad * Eigen::Vector3d(0.6, 0.0, 0.8));
  error.translation() = translation_m * Eigen::Vector3d(0.0, 0.6, -0.8);
  return error;
}

}  // namespace

TEST_CASE("closure error: is the disturbance of the true relative pose", "[evaluation]") {
  const PosesByKey truth = curve();
  const auto error = closure_error(*verified(truth, 4, 1, error_of(0.3, 0.2)).closure, truth);
  REQUIRE(error);
  REQUIRE(error->translation_m == Approx(0.3).epsilon(1e-12));  // measured: 7e-16
  REQUIRE(error->rotation_rad == Approx(0.2).epsilon(1e-12));
  REQUIRE_FALSE(closure_error(*verified(truth, 4, 9, error_of(0.0, 0.0)).closure, truth));
}

TEST_CASE("closure classes: counted as the paper's Table I does", "[evaluation]") {
  const PosesByKey truth = curve();
  const std::vector<RegistrationResult> results{
      verified(truth, 4, 0, error_of(0.049, 0.049)),  // true and kept
      verified(truth, 3, 0, error_of(0.049, 0.049)),  // true, but the back end dropped it
      verified(truth, 4, 1, error_of(0.051, 0.0)),    // false by translation, kept
      verified(truth, 4, 2, error_of(0.0, 0.051)),    // false by rotation, exactly at the weight: not kept
      verified(truth, 3, 1, error_of(0.0, 0.0)),      // true, never seen by the back end
      verified(truth, 3, 9, error_of(0.0, 0.0)),      // no truth, kept
      rejected(RejectionReason::kGicpFitness),        // its weight must not count
      rejected(RejectionReason::kMissingScan),       rejected(RejectionReason::kGicpFitness)};
  const std::vector<double> weights{1.0, 0.1, 0.51, 0.5, std::nan(""), 1.0, 1.0, 1.0, std::nan("")};

  const ClosureStatistics found = closure_statistics(results, weights, 20, truth);
  REQUIRE(found.queued == 20);
  REQUIRE(found.computed == 9);
  REQUIRE(found.verified == 6);
  REQUIRE(found.gnc_inliers == 3);
  REQUIRE(found.true_inliers == 3);
  REQUIRE(found.right_inliers == 1);
  REQUIRE(found.without_truth == 1);
  REQUIRE(found.rejected == std::map<RejectionReason, std::size_t>{{RejectionReason::kMissingScan, 1},
                                                                   {RejectionReason::kGicpFitness, 2}});
  REQUIRE(percent(found.verified, found.queued) == 30.0);
  REQUIRE(percent(0, 0) == 0.0);
}

TEST_CASE("closure classes: a run without registrations has a result", "[evaluation]") {
  const ClosureStatistics found = closure_statistics({}, {}, 7, {});
  REQUIRE(found.queued == 7);
  REQUIRE(found.computed == 0);
  REQUIRE(found.rejected.empty());
}

TEST_CASE("closure classes: counts that do not fit are errors", "[evaluation][error]") {
  const std::vector<RegistrationResult> results{rejected(RejectionReason::kFailed)};
  REQUIRE_THROWS_WITH(closure_statistics(results, {}, 1, {}), "closure statistics: 1 results, but 0 weights");
  REQUIRE_THROWS_WITH(closure_statistics(results, {1.0}, 0, {}), Contains("only 0 queued"));
  ClosureClassOptions options;
  options.true_inlier_m = 0.0;
  REQUIRE_THROWS_WITH(closure_statistics({}, {}, 0, {}, options), "true_inlier_m = 0, must be > 0");
}

}  // namespace loopwise::closure_statistics_test
