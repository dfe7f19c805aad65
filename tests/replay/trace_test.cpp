// SPDX-License-Identifier: BSD-3-Clause
/// The online module against the engine alone: a trace that was recorded while the module's threads worked
/// gives the same graph, closures and estimates, to the bit.
#include <fstream>
#include <mutex>
#include <thread>

#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/replay/trace.hpp>

#include <loopwise/core/recognition.hpp>
#include "testing_mission.hpp"

namespace loopwise::trace_test {
namespace {

using testing::between;
using testing::factors;
using testing::given;
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
class VariableRegistrar final : public Registrar {
 public:
  explicit VariableRegistrar(std::map<Key, Eigen::Isometry3d> truth) : oracle_(std::move(truth)) {}
  [[nodiscard]] std::string_view name() const override { return "variable"; }
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
/// \returns how many of them were accepted
std::size_t produce(LoopClosureModule& module, const Mission& mission, std::size_t robot,
                    std::uint64_t seed) {
  Rng rng(seed);
  std::size_t taken = 0;
  std::vector<BetweenFactor> late;
  std::vector<PriorFactor> late_priors;
  std::vector<Key> late_scans, seen;
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.of(node.key) != robot) continue;
    KeyFrame frame;
    frame.node = node;
    for (const Edge& edge : mission.graph.edges()) {
      if (edge.to == node.key) (rng.uniform() < 0.2 ? late : frame.odometry).push_back(between(edge));
    }
    for (const PriorFactor& prior : mission.graph.priors()) {
      if (prior.key == node.key) (rng.uniform() < 0.5 ? late_priors : frame.priors).push_back(prior);
    }
    if (rng.uniform() < 0.8) {
      frame.cloud = mission.scans->load(node.key);
    } else {
      late_scans.push_back(node.key);
    }
    taken += module.add_key_frame(frame) ? 1 : 0;
    seen.push_back(node.key);
    RadioReading reading;
    reading.key = node.key;
    reading.beacon = "b";
    reading.transmit_dbm = 28.0;
    reading.receive_dbm = rng.uniform() < 0.3 ? -20.0 : -80.0;
    taken += module.add_radio({reading}) ? 1 : 0;
    if (robot == 0 && seen.size() == 5) {
      BeaconDrop drop;
      drop.beacon = "b";
      drop.drop_key = node.key;
      drop.stamp_ns = node.stamp_ns;
      taken += module.add_beacon_drop(drop) ? 1 : 0;
    }
    if (rng.uniform() < 0.2 && !late.empty())
      taken += module.add_factors(factors(std::exchange(late, {}))) ? 1 : 0;
    if (rng.uniform() < 0.2 && !late_scans.empty()) {
      const Key key = late_scans.back();
      late_scans.pop_back();
      taken += module.add_scan(key, mission.scans->load(key)) ? 1 : 0;
    }
    if (rng.uniform() < 0.1 && seen.size() > 6) {
      LoopCandidate candidate;
      candidate.from = seen.back();
      candidate.to = seen[rng.below(seen.size() - 3)];
      auto recognition = std::make_shared<Recognition>();
      if (rng.uniform() < 0.5) recognition->similarity = rng.uniform();
      if (rng.uniform() < 0.5) recognition->T_from_to = testing::random_pose(rng);
      candidate.recognition = std::move(recognition);
      taken += module.add_candidates({candidate}) ? 1 : 0;
    }
    if (rng.uniform() < 0.1)
      taken += module.decide({seen.back(), seen[rng.below(seen.size())], rng.uniform() < 0.3}) ? 1 : 0;
    if (rng.uniform() < 0.1) std::this_thread::sleep_for(std::chrono::microseconds(rng.below(500)));
  }
  taken += module.add_factors(factors(late, late_priors)) ? 1 : 0;
  for (const Key key : late_scans) taken += module.add_scan(key, mission.scans->load(key)) ? 1 : 0;
  return taken;
}

}  // namespace

TEST_CASE("trace: a recorded run of the module is repeated to the bit", "[replay][module][trace]") {
  const Mission mission = two_circles(1, 24);
  const testing::TemporaryFolder folder;
  std::size_t improvements = 0, optimizations = 0;
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    CAPTURE(seed);
    ModuleOptions options;
    options.engine.generation.skip_recent = 3;
    options.engine.seed = seed;
    options.prioritization.method = parse_method(seed % 3 == 0   ? "full+rssi"
                                                 : seed % 3 == 1 ? "expected+rssi"
                                                                 : "random");
    options.prioritization.observability.min_sum = 0.0;
    options.batch = 10;
    options.threads = 2;
    options.queue_capacity = 8;
    std::vector<RegistrationResult> results;  // of the module's thread, read after stop()
    std::vector<std::shared_ptr<const Estimate>> estimates;
    ModuleCallbacks callbacks;
    callbacks.on_result = [&](const RegistrationResult& result) { results.push_back(result); };
    callbacks.on_estimate = [&](const std::shared_ptr<const Estimate>& e) { estimates.push_back(e); };
    const auto path = folder / "trace.jsonl";
    std::ofstream file(path);
    TraceWriter trace(mission.robots, options, [&](const std::string& line) { file << line << "\n"; });
    ModuleParts parts;
    parts.registrar = given(std::make_shared<VariableRegistrar>(mission.ground_truth));
    parts.on_event = [&](const HandledEvent& handled) { trace.add(handled); };
    LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
    std::vector<std::thread> producers;
    for (std::size_t p = 0; p < 4; ++p) {
      producers.emplace_back([&, p] {
        if (p < 2) {
          produce(module, mission, p, 100 * seed + p);
          return;
        }
        Rng rng(100 * seed + p);  // others add what they have found
        for (int i = 0; i < 20; ++i) {
          LoopCandidate candidate;
          candidate.from = make_key('a', rng.below(24));
          candidate.to = make_key('b', rng.below(24));
          static_cast<void>(module.add_candidates({candidate}));
          if (i % 7 == 0) static_cast<void>(module.remove_closure(candidate.from, candidate.to));
        }
      });
    }
    for (std::thread& producer : producers) producer.join();
    if (seed % 4 != 0) REQUIRE(module.wait());
    module.stop();
    file.close();
    improvements += module.statistics().improvements;
    optimizations += estimates.size();

    std::size_t estimate = 0;
    ReplayHooks hooks;
    hooks.moment = [&](const ReplayMoment& moment) {
      if (moment.kind != ReplayMoment::Kind::kBatch) return;
      REQUIRE(estimate < estimates.size());
      REQUIRE(same(moment.graph, estimates[estimate]->graph));
      ++estimate;
    };
    const ReplayResult again = replay_trace(path, hooks);
    REQUIRE(estimate == estimates.size());
    REQUIRE(again.problems.count("trace") == 0);
    REQUIRE(again.computed.size() == results.size());
    for (std::size_t i = 0; i < results.size(); ++i) {
      REQUIRE(outcome_line(again.computed[i].result) == outcome_line(results[i]));
    }
    REQUIRE(same(again.graph, module.graph()));
    const CandidateAccounting a = again.accounting, b = module.statistics().candidates;
    REQUIRE(a.generated == b.generated);
    REQUIRE(a.pruned == b.pruned);
    REQUIRE(a.computed == b.computed);
    REQUIRE(a.pending == b.pending);
    if (seed % 4 != 0) REQUIRE(again.graph.edges().size() > mission.graph.edges().size() + 5);
  }
  REQUIRE(improvements > 0);
  REQUIRE(optimizations > 100);
}

namespace {

/// The lines of a small run.
std::vector<std::string> small_trace(const Mission& mission, ModuleParts parts = {}) {
  ModuleOptions options;
  options.engine.generation.skip_recent = 3;
  options.prioritization.observability.min_sum = 0.0;
  options.threads = 1;
  std::vector<std::string> lines;
  TraceWriter trace(mission.robots, options, [&](const std::string& line) { lines.push_back(line); });
  parts.registrar = given(std::make_shared<OracleRegistrar>(mission.ground_truth));
  parts.on_event = [&](const HandledEvent& handled) { trace.add(handled); };
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  produce(module, mission, 0, 1);
  produce(module, mission, 1, 2);
  REQUIRE(module.wait());
  module.stop();
  return lines;
}

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

}  // namespace

TEST_CASE("trace: a line that cannot be read is named, one that a kill cut short is left out",
          "[replay][trace][error]") {
  const testing::TemporaryFolder folder;
  const auto path = folder / "trace.jsonl";
  const std::vector<std::string> lines = small_trace(two_circles(1, 8));
  const auto replay_of = [&](const std::string& text) {
    testing::write_text(path, text);
    return replay_trace(path);
  };
  const ReplayResult whole = replay_of(joined(lines));
  REQUIRE(whole.problems.empty());

  const std::string text = joined(lines);
  const ReplayResult cut = replay_of(text.substr(0, text.size() - 10));
  REQUIRE(cut.problems.count("trace") == 1);
  REQUIRE(cut.graph.nodes().size() == whole.graph.nodes().size());

  const auto with_line = [&](std::size_t number, const std::string& line) {
    std::vector<std::string> changed = lines;
    changed[number - 1] = line;
    return joined(changed);
  };
  REQUIRE_THROWS_WITH(replay_of(""), Contains("trace.jsonl") && Contains("empty"));
  REQUIRE_THROWS_WITH(replay_of(with_line(1, "{}")), Contains(":1:") && Contains("not a trace"));
  REQUIRE_THROWS_WITH(replay_of(with_line(1, R"({"trace": 9})")), Contains("format 9"));
  REQUIRE_THROWS_WITH(replay_of(with_line(3, "{")), Contains(":3:"));
  REQUIRE_THROWS_WITH(replay_of(with_line(3, R"({"now_s": 0, "event": "dance"})")),
                      Contains(":3:") && Contains("unknown event \"dance\""));
  REQUIRE_THROWS_WITH(replay_of(with_line(3, R"({"now_s": 0, "event": "closure_decision", "from": "1"})")),
                      Contains(":3:") && Contains("to"));
  REQUIRE_THROWS_WITH(replay_of(with_line(3, R"({"now_s": 0, "event": "choose", "count": 1e300})")),
                      Contains(":3:") && Contains("count"));
  REQUIRE_THROWS_WITH(replay_of(with_line(3, R"({"now_s": 0, "event": "choose", "count": -1})")),
                      Contains(":3:") && Contains("count"));
  REQUIRE_THROWS_AS(replay_trace(folder / "missing.jsonl"), IoError);
  REQUIRE_THROWS_AS(replay_trace(folder.path()), IoError);  // opens, but cannot be read

  // An estimate without its hash could not be compared with anything.
  std::vector<std::string> without_hash = lines;
  for (std::string& line : without_hash) {
    const std::size_t at = line.find("\"estimate\":");
    if (at != std::string::npos) line.replace(at, 10, "\"remark\"");
  }
  REQUIRE_THROWS_WITH(replay_of(joined(without_hash)), Contains("without its hash"));

  // An estimate that another machine or version computes differently is reported.
  std::vector<std::string> changed = lines;
  for (std::string& line : changed) {
    const std::size_t at = line.find("\"estimate\":\"");
    if (at != std::string::npos) line[at + 12] = line[at + 12] == '0' ? '1' : '0';
  }
  const std::string code = "\"code\":\"";
  changed[0].insert(changed[0].find(code) + code.size(), "other");
  const ReplayResult other = replay_of(joined(changed));
  REQUIRE(other.problems.count("trace") == 1 + static_cast<std::size_t>(other.optimizations));
  REQUIRE(other.optimizations > 0);
}

TEST_CASE("trace: a run with prioritisers of the user's own is repeated with them", "[replay][trace]") {
  const testing::TemporaryFolder folder;
  const auto make = [] {
    std::vector<std::unique_ptr<Prioritizer>> own;
    own.push_back(std::make_unique<RandomPrioritizer>(7));
    return own;
  };
  ModuleParts parts;
  parts.prioritizers = make();
  // Many more candidates than a batch, so that the order decides which pairs are started.
  testing::write_text(folder / "trace.jsonl", joined(small_trace(two_circles(1, 30), std::move(parts))));
  const ReplayResult again = replay_trace(folder / "trace.jsonl", {}, make);
  REQUIRE(again.problems.empty());
  REQUIRE(again.handed_out.at(0).first == "random");
  REQUIRE(again.computed.size() > 10);
  // Without them other pairs are chosen, which have no results.
  REQUIRE_THROWS_WITH(replay_trace(folder / "trace.jsonl"), Contains("has a result but was not started"));
}

TEST_CASE("trace: an observer of events that throws is reported, and the module continues",
          "[replay][module][trace][error]") {
  const Mission mission = two_circles(1, 12);
  ModuleOptions options;
  options.prioritization.method = parse_method("random");
  options.threads = 1;
  options.engine.generation.skip_recent = 3;
  ModuleParts parts;
  parts.registrar = given(std::make_shared<OracleRegistrar>(mission.ground_truth));
  std::size_t seen = 0;
  parts.on_event = [&](const HandledEvent&) {
    ++seen;
    throw std::runtime_error("no room for a trace");
  };
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  produce(module, mission, 0, 1);
  produce(module, mission, 1, 2);
  REQUIRE(module.wait());
  module.stop();
  REQUIRE(module.graph().nodes().size() == mission.graph.nodes().size());
  REQUIRE(seen > mission.graph.nodes().size());
  REQUIRE(module.statistics().problems >= seen);
  REQUIRE(module.statistics().last_problems.back() == "callback on_event: no room for a trace");
}

TEST_CASE("trace: one that could not be written to its end has no gaps", "[replay][trace][error]") {
  const Mission mission = two_circles(1, 8);
  std::size_t room = 3;
  std::vector<std::string> lines;
  TraceWriter writer(mission.robots, {}, [&](const std::string& line) {
    if (lines.size() == room) throw std::runtime_error("no room");
    lines.push_back(line);
  });
  const Event tick = event::Tick{};
  const HandledEvent handled{tick, 1.0, std::nullopt};
  writer.add(handled);
  writer.add(handled);
  REQUIRE_THROWS_WITH(writer.add(handled), "no room");
  room = 10;  // too late: a line is missing
  REQUIRE_THROWS_AS(writer.add(handled), InputError);
  REQUIRE(lines.size() == 3);
  TraceWriter other(mission.robots, {}, [](const std::string&) {});
  const Event drop = BeaconDrop{
      "K\xfc"
      "che",
      0, mission.graph.nodes()[0].key, 0};
  REQUIRE_THROWS_WITH(other.add({drop, 1.0, std::nullopt}), Contains("UTF-8"));
}

}  // namespace loopwise::trace_test
