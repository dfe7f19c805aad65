// SPDX-License-Identifier: BSD-3-Clause
// The study of registrars: its statistics.
#include <loopwise/study/pair_statistics.hpp>

#include <cmath>

#include "testing.hpp"

namespace loopwise::study::pair_statistics_test {
namespace {

RegistrationResult accepted_at(const Eigen::Isometry3d& T_from_to, double sigma_m, double sigma_rad) {
  RegistrationResult result;
  result.reason = RejectionReason::kNone;
  result.T_from_to = T_from_to;
  LoopClosure closure;
  closure.T_from_to = T_from_to;
  closure.covariance.setZero();
  closure.covariance.diagonal() << Eigen::Vector3d::Constant(sigma_m * sigma_m),
      Eigen::Vector3d::Constant(sigma_rad * sigma_rad);
  result.closure = closure;
  return result;
}

TEST_CASE("judge: right, wrong within its own covariance, and false", "[study]") {
  const Eigen::Isometry3d truth(Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()));
  const auto off = [&](double m, double rad) {
    return Eigen::Isometry3d(truth * Eigen::Translation3d(m, 0, 0) *
                             Eigen::AngleAxisd(rad, Eigen::Vector3d::UnitX()));
  };
  const PairOutcome right = judge(accepted_at(off(0.3, 0.0), 0.1, 0.01), truth);
  REQUIRE(right.right());
  REQUIRE(right.error_m == Approx(0.3));
  REQUIRE(right.squared_mahalanobis == Approx(9.0));
  REQUIRE_FALSE(judge(accepted_at(off(0.3, 0.06), 0.1, 0.01), truth).right());  // 3.4 degrees
  const PairOutcome admitted = judge(accepted_at(off(2.0, 0.0), 1.0, 0.01), truth);
  REQUIRE_FALSE(admitted.right());
  REQUIRE_FALSE(admitted.false_accept());
  REQUIRE(judge(accepted_at(off(2.0, 0.0), 0.1, 0.01), truth).false_accept());
  RegistrationResult refused;
  refused.reason = RejectionReason::kLowOverlap;
  REQUIRE_FALSE(judge(refused, truth).accepted);
}

TEST_CASE("upper_bound_95: Clopper and Pearson's", "[study]") {
  REQUIRE(upper_bound_95(0, 100) == Approx(1.0 - std::pow(0.05, 0.01)).margin(1e-9));
  // P(at most 1 of 50) = (1−p)^50 + 50·p·(1−p)^49 = 0.05
  const double p = upper_bound_95(1, 50);
  REQUIRE(std::pow(1 - p, 50) + 50 * p * std::pow(1 - p, 49) == Approx(0.05).margin(1e-9));
  REQUIRE(upper_bound_95(7, 7) == 1.0);
  REQUIRE(upper_bound_95(0, 0) == 1.0);
}

TEST_CASE("summarize: recall counts overlapping pairs, false accepts all", "[study]") {
  std::vector<StudyPair> pairs(4);
  pairs[0].overlap = pairs[1].overlap = 0.8;
  const Eigen::Isometry3d truth = Eigen::Isometry3d::Identity();
  const Eigen::Isometry3d far(Eigen::Translation3d(5, 0, 0));
  RegistrationResult refused;
  refused.reason = RejectionReason::kLowOverlap;
  std::vector<PairOutcome> outcomes{judge(accepted_at(truth, 0.1, 0.01), truth), judge(refused, truth),
                                    judge(accepted_at(far, 0.1, 0.01), truth),
                                    judge(accepted_at(truth, 0.1, 0.01), truth)};
  const PairSummary s = summarize(pairs, outcomes, {0, 1, 2, 3});
  REQUIRE(s.pairs == 4);
  REQUIRE(s.overlapping == 2);
  REQUIRE(s.recall == 0.5);
  REQUIRE(s.accepted == 3);
  REQUIRE(s.wrong == 1);
  REQUIRE(s.false_accepts == 1);
  REQUIRE(s.false_accept_bound == Approx(upper_bound_95(1, 4)));
  REQUIRE(std::isnan(summarize(pairs, outcomes, {2}).recall));
}

}  // namespace
}  // namespace loopwise::study::pair_statistics_test
