// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/cost_forecast.hpp>

#include "testing_mission.hpp"

namespace loopwise::cost_forecast_test {

TEST_CASE("cost forecast: all candidates of the mission, by a sample of registrations",
          "[replay][forecast]") {
  const Mission mission = testing::two_circles();
  ReplayOptions options;
  const CostForecast forecast = forecast_cost(mission, options, 5);
  REQUIRE(forecast.measured == 5);
  REQUIRE(forecast.registration_s > 0.0);
  REQUIRE(forecast.mission_s == Approx(78.5));
  REQUIRE(forecast.scans == mission.scans->size());
  REQUIRE(forecast.all_s(2) == Approx(0.5 * forecast.all_s(1)));

  // As many as a replay generates whose estimate stays at the odometry.
  options.prioritization.method = parse_method("baseline");
  options.max_registrations = 1;
  const auto registrar = std::make_shared<testing::OracleRegistrar>(mission.ground_truth, 0.0, 1.0);
  const auto features =
      std::make_shared<FeatureCache>(mission.scans->loader(), options.registration.features);
  ThreadPool threads(1);
  const ReplayResult run = MissionReplay(mission, options, {features, registrar}).run(threads);
  REQUIRE(forecast.candidates == run.accounting.queued());

  // The same of thinned ones; a method without proximity has none.
  options.engine.thin = 3;
  const ReplayResult thinned = MissionReplay(mission, options, {features, registrar}).run(threads);
  REQUIRE(forecast_cost(mission, options, 0).candidates == thinned.accounting.queued());
  REQUIRE(thinned.accounting.queued() < run.accounting.queued() / 2);
  options.engine.use_proximity = false;
  REQUIRE(forecast_cost(mission, options, 5).candidates == 0);
  options.engine.use_proximity = true;
  options.engine.thin = 1;

  const CostForecast none = forecast_cost(mission, options, 0);
  REQUIRE(none.candidates == forecast.candidates);
  REQUIRE(none.measured == 0);
  REQUIRE(forecast_text(none, 2).empty());
}

TEST_CASE("cost forecast: the sentence says whether the order matters", "[replay][forecast]") {
  const CostForecast quick{1000, 40, 0.01, 100, 0.02, 60.0};
  REQUIRE(quick.all_in_time(1));
  REQUIRE(
      forecast_text(quick, 1) ==
      "1000 candidates take 12.0 s on 1 thread of this machine (by 40 registrations), the mission lasts 1.0 "
      "min: a live run computes them all, and the method hardly matters");
  const CostForecast slow{100000, 40, 0.01, 100, 0.02, 60.0};
  REQUIRE_FALSE(slow.all_in_time(2));
  REQUIRE(
      forecast_text(slow, 2) ==
      "100000 candidates take 8.3 min on 2 threads of this machine (by 40 registrations), the mission lasts "
      "1.0 min: a live run computes a part, and the method decides which");
}

TEST_CASE("cost forecast: after a run it is of its registrations", "[replay][forecast]") {
  ReplayResult result;
  result.mission_end_s = 100.0;
  result.accounting.generated = 10;
  REQUIRE(forecast_cost(result).measured == 0);
  result.computed.resize(3);
  result.computed[0].result.refine_s = 2.0;
  result.computed[1].result.features_s = 1.0;  // the third took no time: it is an outcome that was known
  const CostForecast forecast = forecast_cost(result);
  REQUIRE(forecast.measured == 2);
  REQUIRE(forecast.registration_s == Approx(1.5));
  REQUIRE(forecast.candidates == 10);
  result.accounting.expired = 5;
  result.expired = {{"missing_scan", 4}, {"too_old", 1}};
  REQUIRE(forecast_cost(result).candidates == 6);
}

}  // namespace loopwise::cost_forecast_test
