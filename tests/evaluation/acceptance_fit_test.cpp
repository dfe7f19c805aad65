// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/acceptance_fit.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

#include "replay/testing_mission.hpp"

namespace loopwise::acceptance_fit_test {
namespace {

/// Samples whose outcomes the given models draw.
AcceptanceSamples drawn(const char* mission, const AcceptanceModel& verified, const AcceptanceModel& right,
                        std::uint64_t seed) {
  Rng rng(seed);
  AcceptanceSamples out{mission, {}};
  for (int i = 0; i < 6000; ++i) {
    AcceptanceSample sample;
    sample.evidence.overlap = rng.uniform();
    sample.evidence.distance_m = rng.uniform(0.0, 30.0);
    sample.verified = rng.uniform() < verified.probability(sample.evidence);
    sample.right = sample.verified && rng.uniform() < right.probability(sample.evidence);
    out.samples.push_back(sample);
  }
  return out;
}

}  // namespace

TEST_CASE("acceptance fit: finds the models that generated the outcomes", "[evaluation][acceptance]") {
  const AcceptanceModel verified({-2.0, 3.0, 2.0, 0.0, -0.8, 0.0}), right({1.0, 2.0, 0.0, 0.0, -0.4, 0.0});
  const std::vector<AcceptanceSamples> missions{
      drawn("one", verified, right, 1), drawn("two", verified, right, 2), drawn("three", verified, right, 3)};
  for (const auto& [outcome, truth] :
       {std::pair(AcceptanceOutcome::kVerified, &verified), std::pair(AcceptanceOutcome::kRight, &right)}) {
    const AcceptanceFit fit = fit_acceptance(missions, outcome);
    const AcceptanceModel model(fit.weights);
    for (const double overlap : {0.1, 0.5, 0.9}) {
      const CandidateEvidence evidence{overlap, 8.0, false};
      REQUIRE(model.probability(evidence) == Approx(truth->probability(evidence)).margin(0.04));
    }
    REQUIRE(fit.scores.size() == 3);
    for (const AcceptanceScore& score : fit.scores) {
      REQUIRE(score.auc > score.auc_by_distance);
      REQUIRE(score.brier < 0.25);
      REQUIRE(score.positive < score.count);
    }
    for (const Calibration::Bin& bin : fit.calibration.bins()) {
      if (bin.count < 300) continue;
      const auto count = static_cast<double>(bin.count);
      REQUIRE(static_cast<double>(bin.verified) / count == Approx(bin.expected / count).margin(0.06));
    }
  }
  REQUIRE(fit_acceptance({missions.front()}, AcceptanceOutcome::kVerified).scores.empty());
}

TEST_CASE("acceptance fit: outcomes that are all alike are an error", "[evaluation][acceptance][error]") {
  AcceptanceSamples mission{"one", {{CandidateEvidence{0.5, 3.0, false}, false, false}}};
  REQUIRE_THROWS_WITH(fit_acceptance({mission}, AcceptanceOutcome::kVerified),
                      Contains("nothing can be fitted"));
  REQUIRE_THROWS_WITH(fit_acceptance({mission}, AcceptanceOutcome::kRight), Contains("verified closures"));
}

TEST_CASE("acceptance fit: folds that allow no fit have no score", "[evaluation][acceptance]") {
  const AcceptanceModel verified({-2.0, 3.0, 2.0, 0.0, -0.8, 0.0}), right({1.0, 2.0, 0.0, 0.0, -0.4, 0.0});
  const AcceptanceSamples whole = drawn("whole", verified, right, 1);
  AcceptanceSamples failed = drawn("failed", verified, right, 2);
  for (AcceptanceSample& sample : failed.samples) sample.verified = sample.right = false;
  // Without "whole" there is no verified candidate for a fit; the fit without "failed" has a score.
  const AcceptanceFit fit = fit_acceptance({whole, failed}, AcceptanceOutcome::kVerified);
  REQUIRE(fit.scores.size() == 2);
  REQUIRE(fit.scores[0].count == 6000);
  REQUIRE(fit.scores[0].positive > 0);
  REQUIRE(std::isnan(fit.scores[0].auc));
  REQUIRE(std::isnan(fit.scores[0].auc_by_distance));
  REQUIRE(std::isnan(fit.scores[0].brier));
  REQUIRE(fit.scores[1].brier >= 0.0);
  std::size_t calibrated = 0;
  for (const Calibration::Bin& bin : fit.calibration.bins()) calibrated += bin.count;
  REQUIRE(calibrated == 6000);
}

TEST_CASE("acceptance fit: the area under the ROC curve", "[evaluation][acceptance]") {
  REQUIRE(roc_auc({0.1, 0.2, 0.3, 0.4}, {false, false, true, true}) == 1.0);
  REQUIRE(roc_auc({0.4, 0.3, 0.2, 0.1}, {false, false, true, true}) == 0.0);
  REQUIRE(roc_auc({0.5, 0.5, 0.5}, {false, true, true}) == 0.5);
  REQUIRE(roc_auc({0.1, 0.3, 0.2}, {false, true, true}) == 1.0);
  REQUIRE(roc_auc({1.0, 2.0, 2.0, 3.0}, {true, false, true, false}) == Approx(1.0 - 3.5 / 4.0));
  REQUIRE(std::isnan(roc_auc({0.1, 0.2}, {true, true})));
  REQUIRE_THROWS_WITH(roc_auc({0.1}, {}), Contains("as many scores"));
  REQUIRE_THROWS_WITH(roc_auc({0.1, std::nan("")}, {true, false}), Contains("not a number"));
}

TEST_CASE("acceptance fit: a replay gives the evidence of its registrations", "[evaluation][acceptance]") {
  const Mission mission = testing::two_circles();
  ReplayOptions options;
  options.batch = 20;
  options.max_registrations = 60;
  const Registration registration{
      std::make_shared<FeatureCache>(mission.scans->loader(), options.registration.features),
      std::make_shared<testing::OracleRegistrar>(mission.ground_truth)};
  ThreadPool threads(1);
  const AcceptanceSamples samples = collect_acceptance(mission, options, registration, threads);
  REQUIRE(samples.samples.size() == 60);
  std::size_t verified = 0;
  for (const AcceptanceSample& sample : samples.samples) {
    REQUIRE(sample.evidence.overlap >= 0.0);
    REQUIRE(sample.evidence.overlap <= 1.0);
    REQUIRE(sample.evidence.distance_m > 0.0);
    REQUIRE(sample.evidence.distance_m <= 35.0);
    REQUIRE((sample.verified || !sample.right));
    verified += sample.verified ? 1 : 0;
  }
  REQUIRE(verified > 30);  // three tenths are refused
  REQUIRE(verified < 55);
}

}  // namespace loopwise::acceptance_fit_test
