// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include <loopwise/io/decisions.hpp>
#include <loopwise/replay/live_replay.hpp>
#include <loopwise/replay/rank.hpp>
#include <loopwise/replay/replay.hpp>

#include "testing_mission.hpp"

namespace loopwise::decisions_test {
namespace {

using Catch::Matchers::Contains;
using testing::OracleRegistrar;
using testing::two_circles;

ReplayOptions replay_options() {
  ReplayOptions options;
  options.prioritization.method = parse_method("random");
  options.prioritization.observability.min_sum = 0.0;
  options.engine.generation.skip_recent = 3;
  options.after_mission = true;
  return options;
}

ReplayResult run(const Mission& mission, const ReplayOptions& options) {
  ThreadPool threads(1);
  const auto features =
      std::make_shared<FeatureCache>(mission.scans->loader(), options.registration.features);
  return MissionReplay(mission, options, {features, std::make_shared<OracleRegistrar>(mission.ground_truth)})
      .run(threads);
}

/// At any time that is asked for.
class FastClock final : public Clock {
 public:
  [[nodiscard]] double now() const override { return now_s_; }
  void wait_until(double time_s, const StopToken&) override { now_s_ = time_s; }

 private:
  std::atomic<double> now_s_{0.0};
};

ReplayResult run_live(const Mission& mission, const ReplayOptions& options) {
  FastClock clock;
  return replay_live(mission, options, std::make_shared<OracleRegistrar>(mission.ground_truth), clock, 1);
}

std::vector<Edge> closures_between(const PoseGraph& graph, Key a, Key b) {
  std::vector<Edge> found;
  for (const Edge& edge : graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure && std::minmax(edge.from, edge.to) == std::minmax(a, b)) {
      found.push_back(edge);
    }
  }
  return found;
}

bool computed(const ReplayResult& result, const ClosureDecision& pair) {
  return std::any_of(result.computed.begin(), result.computed.end(), [&](const ComputedCandidate& c) {
    return std::minmax(c.result.candidate.from, c.result.candidate.to) == std::minmax(pair.from, pair.to);
  });
}

}  // namespace

TEST_CASE("replay: a person's decisions hold from the start", "[replay][decisions]") {
  const Mission mission = two_circles(1, 16);
  ReplayOptions options = replay_options();
  const ReplayResult before = run(mission, options);
  std::vector<Edge> closures;
  for (const Edge& edge : before.graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) closures.push_back(edge);
  }
  REQUIRE(closures.size() > 10);
  const ClosureDecision rejected{closures[2].to, closures[2].from, false};
  const ClosureDecision accepted{closures[5].from, closures[5].to, true};
  const ClosureDecision never{make_key('a', 0), make_key('a', 1), true};  // neighbours: no candidate
  REQUIRE(computed(before, rejected));
  REQUIRE(before.problems.empty());

  const testing::TemporaryFolder folder;
  options.decisions = (folder / "decisions.csv").string();
  testing::write_text(options.decisions, decisions_csv({rejected, accepted, never}));
  for (const ReplayResult& after : {run(mission, options), run_live(mission, options)}) {
    REQUIRE_FALSE(computed(after, rejected));
    REQUIRE(closures_between(after.graph, rejected.from, rejected.to).empty());
    const std::vector<Edge> kept = closures_between(after.graph, accepted.from, accepted.to);
    REQUIRE(kept.size() == 1);
    REQUIRE(kept[0].trusted);
    REQUIRE(kept[0].weight == 1.0);
    REQUIRE(after.problems.count("accepted pair without a closure") == 1);
  }

  const auto has = [](const std::vector<LoopCandidate>& candidates, const ClosureDecision& pair) {
    return std::any_of(candidates.begin(), candidates.end(), [&](const LoopCandidate& c) {
      return std::minmax(c.from, c.to) == std::minmax(pair.from, pair.to);
    });
  };
  REQUIRE(has(all_candidates(mission, replay_options()), rejected));
  REQUIRE_FALSE(has(all_candidates(mission, options), rejected));
}

TEST_CASE("replay: a decision takes precedence over robust optimisation", "[replay][decisions]") {
  const Mission mission = two_circles(1, 16);
  ReplayOptions options = replay_options();
  // Every closure contradicts odometry by far: none would be kept.
  options.back_end.gnc.inlier_probability = 1e-6;
  const ReplayResult before = run(mission, options);
  const auto outlier = std::find_if(before.graph.edges().begin(), before.graph.edges().end(),
                                    [](const Edge& edge) { return edge.weight < 0.5; });
  REQUIRE(outlier != before.graph.edges().end());
  const testing::TemporaryFolder folder;
  options.decisions = (folder / "decisions.csv").string();
  testing::write_text(options.decisions, decisions_csv({{outlier->from, outlier->to, true}}));
  const std::vector<Edge> kept = closures_between(run(mission, options).graph, outlier->from, outlier->to);
  REQUIRE(kept.size() == 1);
  REQUIRE(kept[0].weight == 1.0);
}

TEST_CASE("replay: decisions of another mission are an error, other decisions another run",
          "[replay][decisions][error]") {
  const Mission mission = two_circles(1, 6);
  const testing::TemporaryFolder folder;
  ReplayOptions options = replay_options();
  const std::string without = options_key(options);
  options.decisions = (folder / "decisions.csv").string();
  testing::write_text(options.decisions, decisions_csv({{make_key('z', 1), make_key('a', 1), false}}));
  const std::string with = options_key(options);
  REQUIRE_THROWS_WITH(run(mission, options), Contains("decisions.csv") && Contains("no node z1"));
  testing::write_text(options.decisions, decisions_csv({{make_key('a', 3), make_key('a', 1), false}}));
  REQUIRE(options_key(options) != with);
  REQUIRE(options_key(options) != without);
}

}  // namespace loopwise::decisions_test
