// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/acceptance.hpp>

#include <cmath>
#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

#include "testing.hpp"

namespace loopwise::acceptance_test {
namespace {

using Results = std::vector<std::pair<CandidateEvidence, bool>>;

CandidateEvidence random_evidence(Rng& rng) {
  CandidateEvidence evidence;
  evidence.overlap = rng.uniform();
  evidence.distance_m = rng.uniform(0.0, 30.0);
  return evidence;
}

Results results_of(const AcceptanceModel& truth, std::size_t count, Rng& rng) {
  Results results;
  for (std::size_t i = 0; i < count; ++i) {
    const CandidateEvidence evidence = random_evidence(rng);
    results.emplace_back(evidence, rng.uniform() < truth.probability(evidence));
  }
  return results;
}

}  // namespace

TEST_CASE("acceptance: the model fits the chances of the results", "[prioritization][acceptance]") {
  Rng rng(1);
  const AcceptanceModel truth({-1.0, 4.0, 0.0, 0.0, -0.5, 0.0});
  AcceptanceModel model(AcceptanceModel::shipped_verified());
  model.fit(results_of(truth, 20000, rng));
  Calibration calibration;
  double worst = 0.0;
  for (int i = 0; i < 4000; ++i) {
    const CandidateEvidence evidence = random_evidence(rng);
    worst = std::max(worst, std::abs(model.probability(evidence) - truth.probability(evidence)));
    calibration.add(model.probability(evidence), rng.uniform() < truth.probability(evidence));
  }
  REQUIRE(worst < 0.15);  // measured 0.07
  for (const Calibration::Bin& bin : calibration.bins()) {
    if (bin.count < 200) continue;
    const auto count = static_cast<double>(bin.count);
    REQUIRE(static_cast<double>(bin.verified) / count == Approx(bin.expected / count).margin(0.08));
  }
}

TEST_CASE("acceptance: it begins with the shipped weights, and few results change it little",
          "[prioritization][acceptance]") {
  AcceptanceModel model(AcceptanceModel::shipped_verified());
  REQUIRE(model.weights() == AcceptanceModel::shipped_verified());
  model.fit({});
  for (std::size_t k = 0; k < AcceptanceModel::kTerms; ++k)
    REQUIRE(model.weights()[k] == Approx(AcceptanceModel::shipped_verified()[k]));
  // More overlap and less distance never hurt, with the shipped weights.
  Rng rng(2);
  for (int i = 0; i < 200; ++i) {
    CandidateEvidence evidence = random_evidence(rng);
    const double p = model.probability(evidence);
    evidence.overlap = std::min(1.0, evidence.overlap + 0.1);
    REQUIRE(model.probability(evidence) >= p);
    evidence.distance_m *= 0.5;
    REQUIRE(model.probability(evidence) >= p);
  }
  CandidateEvidence near;
  near.overlap = 0.9;
  const double before = model.probability(near);
  model.fit({{near, false}, {near, false}});
  REQUIRE(model.probability(near) < before);
  REQUIRE(model.probability(near) > 0.5 * before);
}

TEST_CASE("acceptance: the fit is stable if results contradict the prior", "[prioritization][acceptance]") {
  // Closures between places that look alike, half of which are taken back at once.
  Rng rng(4);
  AcceptanceModel model(AcceptanceModel::shipped_right());
  Results results;
  for (int i = 0; i < 400; ++i) {
    CandidateEvidence evidence;
    evidence.overlap = rng.uniform(0.7, 1.0);
    evidence.distance_m = rng.uniform(0.0, 5.0);
    results.emplace_back(evidence, true);
  }
  model.fit(results);
  for (std::size_t i = 0; i < results.size(); i += 2) results[i].second = false;
  model.fit(results);
  double sum = 0.0;
  for (const auto& result : results) sum += model.probability(result.first);
  REQUIRE(sum / 400.0 > 0.5);
  REQUIRE(sum / 400.0 < 0.75);  // 0.5, but for the prior; measured 0.68
  const AcceptanceModel::Terms weights = model.weights();
  model.fit(results);  // it was done
  for (std::size_t k = 0; k < AcceptanceModel::kTerms; ++k) {
    REQUIRE(model.weights()[k] == Approx(weights[k]).margin(1e-4));
  }
}

TEST_CASE("acceptance: without overlap distance counts, for candidates from outside only the share",
          "[prioritization][acceptance]") {
  AcceptanceModel model(AcceptanceModel::shipped_verified());
  CandidateEvidence near, far;
  far.distance_m = 25.0;
  REQUIRE(model.probability(near) > 2.0 * model.probability(far));
  near.from_outside = far.from_outside = true;
  REQUIRE(model.probability(near) == model.probability(far));
  const double before = model.probability(far);
  Results results(100, {far, true});
  model.fit(results);
  REQUIRE(model.probability(near) > before);
  near.from_outside = false;
  REQUIRE(model.probability(near) ==
          Approx(AcceptanceModel(AcceptanceModel::shipped_verified()).probability(near)));
}

TEST_CASE("acceptance: the more alike a recognised place looks, the likelier, also once it is fitted",
          "[prioritization][acceptance]") {
  Rng rng(4);
  AcceptanceModel model(AcceptanceModel::shipped_verified());
  CandidateEvidence evidence;
  evidence.overlap = 0.3;
  evidence.distance_m = 5.0;
  const auto rises = [&] {
    double before = 0.0;
    for (const double similarity : {0.0, 0.3, 0.6}) {
      evidence.similarity = similarity;
      REQUIRE(model.probability(evidence) > before);
      before = model.probability(evidence);
    }
  };
  rises();
  // Results without recognition do not change its weight.
  Results results = results_of(AcceptanceModel({-1.0, 4.0, 0.0, 0.0, -0.5, 0.0}), 2000, rng);
  model.fit(results);
  rises();
  // Successes that recognition explains are not attributed to overlap.
  AcceptanceModel other(AcceptanceModel::shipped_verified()), same = other;
  for (auto& [of, verified] : results) of.similarity = 0.5;
  other.fit(results);
  same.fit(results_of(AcceptanceModel({-1.0, 4.0, 0.0, 0.0, -0.5, 0.0}), 2000, rng));
  REQUIRE(other.weights()[0] < same.weights()[0]);
}

TEST_CASE("acceptance: evidence that is not finite gives a probability all the same",
          "[prioritization][acceptance][error]") {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  const AcceptanceModel model(AcceptanceModel::shipped_verified());
  for (const double bad : {std::nan(""), kInf, -kInf, 1e300}) {
    CandidateEvidence evidence;
    evidence.overlap = bad;
    evidence.distance_m = bad;
    const double p = model.probability(evidence);
    REQUIRE((p > 0.0 && p < 1.0));
  }
  AcceptanceModel::Terms weights{};
  weights[2] = kInf;
  REQUIRE_THROWS_AS(AcceptanceModel(weights), OptionError);
  REQUIRE_THROWS_AS(AcceptanceModel(AcceptanceModel::Terms{}, 0.0), OptionError);
}

TEST_CASE("acceptance: weights as an option has them", "[prioritization][acceptance][error]") {
  REQUIRE(AcceptanceModel::parse("0.4,10.1,-3.6,2,-2.7,-1", "o") ==
          AcceptanceModel::Terms{0.4, 10.1, -3.6, 2.0, -2.7, -1.0});
  REQUIRE_THROWS_WITH(AcceptanceModel::parse("1,2,3", "expected.right_weights"),
                      "expected.right_weights: 3 numbers, 6 are needed");
  REQUIRE_THROWS_WITH(AcceptanceModel::parse("1,2,3,4,5,6,7", "o"), Contains("7 numbers"));
  REQUIRE_THROWS_WITH(AcceptanceModel::parse("1,2,x,4,5,6", "o"), "o: \"x\" is not a number");
  for (const char* bad : {"", ",", "1,2,3,4,5,", "1,2,3,4,5,nan", "1,2,3,4,5,inf", "1, 2,3,4,5,6"})
    REQUIRE_THROWS_AS(AcceptanceModel::parse(bad, "o"), OptionError);
}

TEST_CASE("calibration: reliability and Brier score", "[prioritization][acceptance]") {
  Calibration calibration;
  REQUIRE(std::isnan(calibration.brier()));
  calibration.add(0.25, true);
  calibration.add(0.25, false);
  calibration.add(1.0, true);
  REQUIRE(calibration.brier() == Approx((0.75 * 0.75 + 0.25 * 0.25) / 3.0));
  REQUIRE(calibration.bins()[2].count == 2);
  REQUIRE(calibration.bins()[2].verified == 1);
  REQUIRE(calibration.bins()[2].expected == Approx(0.5));
  REQUIRE(calibration.bins()[9].count == 1);
}

}  // namespace loopwise::acceptance_test
