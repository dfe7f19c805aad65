// SPDX-License-Identifier: BSD-3-Clause
/// The online module against the engine alone: the events that the module's threads brought about give the
/// same graph, closures and estimates again, to the bit.
#include <mutex>
#include <thread>

#include <loopwise/engine/engine.hpp>
#include <loopwise/pipeline/loop_closure_module.hpp>

#include "testing_mission.hpp"

namespace loopwise {
namespace {

using testing::OracleRegistrar;
using testing::two_circles;

bool same(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return a.matrix() == b.matrix();
}

bool same(const PoseGraph& a, const PoseGraph& b) {
  const auto same_node = [](const Node& x, const Node& y) { return x.key == y.key && same(x.pose, y.pose); };
  const auto same_edge = [](const Edge& x, const Edge& y) {
    return x.from == y.from && x.to == y.to && x.kind == y.kind && x.weight == y.weight &&
           same(x.T_from_to, y.T_from_to) && x.information == y.information;
  };
  return a.priors().size() == b.priors().size() &&
         std::equal(a.nodes().begin(), a.nodes().end(), b.nodes().begin(), b.nodes().end(), same_node) &&
         std::equal(a.edges().begin(), a.edges().end(), b.edges().begin(), b.edges().end(), same_edge);
}

/// Now and then slow, now and then without a closure.
class UnevenRegistrar final : public Registrar {
 public:
  explicit UnevenRegistrar(std::map<Key, Eigen::Isometry3d> truth) : oracle_(std::move(truth)) {}
  [[nodiscard]] std::string_view name() const override { return "uneven"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    Rng rng(task.seed);
    if (rng.uniform() < 0.05) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (rng.uniform() < 0.7) return oracle_.compute(task);
    RegistrationResult result;
    result.candidate = task.candidate;
    result.reason = RejectionReason::kLowOverlap;
    return result;
  }

 private:
  OracleRegistrar oracle_;
};

/// Feeds one robot in pieces: scans, odometry and priors late or early, radio, a beacon, vetoes, candidates.
void produce(LoopClosureModule& module, const Mission& mission, std::size_t robot, std::uint64_t seed) {
  Rng rng(seed);
  std::vector<Edge> late;
  std::vector<PriorFactor> late_priors;
  std::vector<Key> late_scans, seen;
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.of(node.key) != robot) continue;
    KeyFrame frame;
    frame.node = node;
    for (const Edge& edge : mission.graph.edges()) {
      if (edge.to == node.key) (rng.uniform() < 0.2 ? late : frame.factors).push_back(edge);
    }
    for (const PriorFactor& prior : mission.graph.priors()) {
      if (prior.key == node.key) (rng.uniform() < 0.5 ? late_priors : frame.priors).push_back(prior);
    }
    if (rng.uniform() < 0.8) {
      frame.cloud = mission.scans->load(node.key);
    } else {
      late_scans.push_back(node.key);
    }
    module.add_key_frame(frame);
    seen.push_back(node.key);
    RadioReading reading;
    reading.key = node.key;
    reading.beacon = "b";
    reading.transmit_dbm = 28.0;
    reading.receive_dbm = rng.uniform() < 0.3 ? -20.0 : -80.0;
    module.add_radio({reading});
    if (robot == 0 && seen.size() == 5) {
      BeaconDrop drop;
      drop.beacon = "b";
      drop.drop_key = node.key;
      drop.stamp_ns = node.stamp_ns;
      module.add_beacon_drop(drop);
    }
    if (rng.uniform() < 0.2 && !late.empty()) module.add_factors(std::exchange(late, {}));
    if (rng.uniform() < 0.2 && !late_scans.empty()) {
      const Key key = late_scans.back();
      late_scans.pop_back();
      module.add_scan(key, mission.scans->load(key));
    }
    if (rng.uniform() < 0.1 && seen.size() > 6) {
      LoopCandidate candidate;
      candidate.from = seen.back();
      candidate.to = seen[rng.below(seen.size() - 3)];
      module.add_candidates({candidate});
    }
    if (rng.uniform() < 0.1) module.remove_closure(seen.back(), seen[rng.below(seen.size())]);
    if (rng.uniform() < 0.1) std::this_thread::sleep_for(std::chrono::microseconds(rng.below(500)));
  }
  module.add_factors(late, late_priors);
  for (const Key key : late_scans) module.add_scan(key, mission.scans->load(key));
}

}  // namespace

TEST_CASE("trace: what the module's threads brought about, the engine repeats to the bit",
          "[pipeline][module][trace]") {
  const Mission mission = two_circles(1, 24);
  std::size_t improvements = 0;
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    CAPTURE(seed);
    Config config;
    config.observability.min_sum = 0.0;
    config.generation.skip_recent = 3;
    ModuleOptions options;
    options.method = seed % 2 == 0 ? "full+rssi" : "random";
    options.batch = 10;
    options.threads = 2;
    options.seed = seed;
    options.queue_capacity = 8;
    struct Recorded {
      Event event;
      double now_s;
    };
    std::vector<Recorded> trace;  // from the module's thread, read after stop()
    std::vector<LoopClosure> closures;
    std::vector<std::shared_ptr<const Estimate>> estimates;
    ModuleCallbacks callbacks;
    callbacks.closure = [&](const LoopClosure& closure) { closures.push_back(closure); };
    callbacks.estimate = [&](const std::shared_ptr<const Estimate>& e) { estimates.push_back(e); };
    ModuleParts parts;
    parts.registrar = std::make_shared<UnevenRegistrar>(mission.ground_truth);
    parts.on_event = [&](const Event& event, double now_s) { trace.push_back({event, now_s}); };
    LoopClosureModule module(mission.robots, options, config, callbacks, std::move(parts));
    std::vector<std::thread> producers;
    for (std::size_t p = 0; p < 4; ++p) {
      producers.emplace_back([&, p] {
        if (p < 2) return produce(module, mission, p, 100 * seed + p);
        Rng rng(100 * seed + p);  // others add what they have found
        for (int i = 0; i < 20; ++i) {
          LoopCandidate candidate;
          candidate.from = make_key('a', rng.below(24));
          candidate.to = make_key('b', rng.below(24));
          module.add_candidates({candidate});
          if (i % 7 == 0) module.remove_closure(candidate.from, candidate.to);
        }
      });
    }
    for (std::thread& producer : producers) producer.join();
    if (seed % 3 != 0) REQUIRE(module.wait());
    module.stop();
    improvements += module.statistics().improvements;

    config.replay.method = options.method;
    config.replay.seed = options.seed;
    FeatureCache features(mission.scans->loader(), config.features);
    Engine engine(
        mission.robots, engine_options(config, options),
        make_queue(config, mission.robots, observability_of(features, config.observability.variant)));
    std::size_t closure = 0, estimate = 0;
    for (const Recorded& recorded : trace) {
      for (const Effect& effect : engine.handle(recorded.event, recorded.now_s)) {
        if (const auto* found = std::get_if<effect::Closure>(&effect)) {
          REQUIRE(closure < closures.size());
          REQUIRE(found->closure.from == closures[closure].from);
          REQUIRE(found->closure.to == closures[closure].to);
          REQUIRE(same(found->closure.T_from_to, closures[closure].T_from_to));
          ++closure;
        } else if (const auto* made = std::get_if<effect::EstimateReady>(&effect)) {
          REQUIRE(estimate < estimates.size());
          REQUIRE(same(made->estimate->graph, estimates[estimate]->graph));
          ++estimate;
        }
      }
    }
    REQUIRE(closure == closures.size());
    REQUIRE(estimate == estimates.size());
    REQUIRE(same(engine.graph(), module.graph()));
    const CandidateAccounting a = engine.pool().accounting(), b = module.statistics().candidates;
    REQUIRE(a.generated == b.generated);
    REQUIRE(a.computed == b.computed);
    REQUIRE(a.pending == b.pending);
    if (seed % 3 != 0) REQUIRE(closures.size() > 5);
  }
  REQUIRE(improvements > 0);
}

TEST_CASE("trace: an observer of events that throws is reported, and the module goes on",
          "[pipeline][module][trace][error]") {
  const Mission mission = two_circles(1, 12);
  ModuleOptions options;
  options.method = "random";
  options.threads = 1;
  Config config;
  config.generation.skip_recent = 3;
  ModuleParts parts;
  parts.registrar = std::make_shared<OracleRegistrar>(mission.ground_truth);
  std::size_t seen = 0;
  parts.on_event = [&](const Event&, double) {
    ++seen;
    throw std::runtime_error("no room for a trace");
  };
  LoopClosureModule module(mission.robots, options, config, {}, std::move(parts));
  produce(module, mission, 0, 1);
  produce(module, mission, 1, 2);
  REQUIRE(module.wait());
  module.stop();
  REQUIRE(module.graph().nodes().size() == mission.graph.nodes().size());
  REQUIRE(seen > mission.graph.nodes().size());
  REQUIRE(module.statistics().problems >= seen);
  REQUIRE(module.statistics().last_problems.back() == "a callback threw: no room for a trace");
}

}  // namespace loopwise
