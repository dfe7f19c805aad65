// SPDX-License-Identifier: BSD-3-Clause
// A test of map quality for every commit: it replays a recorded mission, without network or GPU, with the
// same result every time.
#if __has_include(<catch2/catch_test_macros.hpp>)
#include <catch2/catch_test_macros.hpp>
#else
#define CATCH_CONFIG_MAIN
#include <catch2/catch.hpp>
#endif

#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/replay/replay.hpp>

using namespace loopwise;

namespace {

ReplayResult replayed(const Mission& mission, int threads) {
  ReplayOptions options;
  options.max_registrations = 60;  // keeps the test short
  options.cost.registration_time_s = 5.0;
  return replay(mission, options, {}, threads);
}

}  // namespace

TEST_CASE("the map of the recorded mission is as good as it was") {
  const Mission mission = read_mission(MISSION);
  REQUIRE(mission.problems.empty());
  const RunEvaluation evaluation = evaluate_run(mission, replayed(mission, 2));

  CHECK(evaluation.closures.verified >= 10);
  CHECK(evaluation.closures.true_inliers >= 0.9 * static_cast<double>(evaluation.closures.verified));
  CHECK(evaluation.optimized.ate_m.mean < 0.5 * evaluation.odometry.ate_m.mean);
}

TEST_CASE("the number of threads changes nothing") {
  const Mission mission = read_mission(MISSION);
  CHECK(closures_csv(replayed(mission, 1)).size() > 1000);
  const ReplayResult one = replayed(mission, 1), four = replayed(mission, 4);
  REQUIRE(one.graph.nodes().size() == four.graph.nodes().size());
  for (std::size_t i = 0; i < one.graph.nodes().size(); ++i) {
    REQUIRE(one.graph.nodes()[i].pose.matrix() == four.graph.nodes()[i].pose.matrix());  // every bit
  }
}
