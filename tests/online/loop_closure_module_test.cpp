// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <fstream>
#include <functional>
#include <future>
#include <iterator>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include <loopwise/joining/join.hpp>
#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/prioritization/baselines.hpp>

#include "module_testing.hpp"

namespace loopwise::loop_closure_module_test {
namespace {

using testing::between;
using testing::CallbackPrioritizer;
using testing::factors;
using testing::given;
using testing::key_frames;
using testing::module_options;
using testing::OracleRegistrar;
using testing::two_circles;
using testing::with_oracle;

/// Stands where it is set.
class ManualClock final : public Clock {
 public:
  [[nodiscard]] double now() const override { return now_s; }
  void wait_until(double, const StopToken&) override {}
  std::atomic<double> now_s{0.0};
};

double mean_error(const Mission& mission, const PoseGraph& graph) {
  double sum = 0.0;
  for (const Node& node : graph.nodes()) {
    sum += (node.pose.translation() - mission.ground_truth.at(node.key).translation()).norm();
  }
  return sum / static_cast<double>(graph.nodes().size());
}

LoopCandidate pair(Key from, Key to) {
  LoopCandidate candidate;
  candidate.from = from;
  candidate.to = to;
  return candidate;
}

}  // namespace

TEST_CASE("module: closes loops, keeps account, reports every event", "[online][module]") {
  const Mission mission = two_circles();
  for (const std::string& method : method_names()) {
    if (method == "odom" || method == "rssi") continue;
    CAPTURE(method);
    std::size_t results = 0, closures = 0, estimates = 0;  // called back one at a time, read after wait()
    std::vector<std::string> problems;
    ModuleCallbacks callbacks;
    callbacks.on_result = [&](const RegistrationResult&) { ++results; };
    callbacks.on_closure = [&](const LoopClosure&) { ++closures; };
    callbacks.on_estimate = [&](const std::shared_ptr<const Estimate>& estimate) {
      ++estimates;
      REQUIRE(estimate->revision == estimates);
    };
    callbacks.on_problem = [&](const std::string& text) { problems.push_back(text); };
    ModuleOptions options = module_options(method);
    options.batch = 100;
    LoopClosureModule module(mission.robots, options, callbacks, with_oracle(mission));
    for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
    REQUIRE(module.wait());

    const ModuleStatistics statistics = module.statistics();
    const CandidateAccounting& account = statistics.candidates;
    REQUIRE(problems.empty());
    REQUIRE(account.balanced());
    REQUIRE(account.generated > 1000);
    REQUIRE(account.pending + account.in_flight + account.waiting == 0);
    REQUIRE(account.computed == account.queued());
    REQUIRE(results == account.computed);
    REQUIRE(estimates > 0);
    const PoseGraph graph = module.graph();
    REQUIRE(graph.nodes().size() == mission.graph.nodes().size());
    REQUIRE(graph.edges().size() == mission.graph.edges().size() + closures);
    REQUIRE(mean_error(mission, graph) < 0.2 * mean_error(mission, mission.graph));  // 0.05 was measured
    std::size_t handed_out = 0;
    for (const auto& [name, count] : statistics.handed_out) handed_out += count;
    REQUIRE(handed_out == account.computed);
    REQUIRE(statistics.events_waiting == 0);
    module.stop();
    REQUIRE_FALSE(module.wait());
    REQUIRE_FALSE(module.add_candidates({pair(make_key('a', 1), make_key('b', 1))}));
    REQUIRE(module.graph().edges().size() == graph.edges().size());
  }
}

TEST_CASE("module: a registrar of the user's own gets the clouds that the module keeps", "[online][module]") {
  /// Verifies pairs whose clouds are both there.
  class CloudCheckingRegistrar final : public Registrar {
   public:
    CloudCheckingRegistrar(ScanLoader scans, std::map<Key, Eigen::Isometry3d> truth)
        : scans_(std::move(scans)), oracle_(std::move(truth), 0.0, 0.0) {}
    [[nodiscard]] std::string_view name() const override { return "cloud_checking"; }
    [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
      if (!scans_(task.candidate.from) || !scans_(task.candidate.to)) throw InputError("a cloud is missing");
      return oracle_.compute(task);
    }

   private:
    ScanLoader scans_;
    OracleRegistrar oracle_;
  };
  const Mission mission = two_circles(1, 12);
  ModuleParts parts;
  parts.registrar = [&](const ScanLoader& scans) {
    return std::make_shared<const CloudCheckingRegistrar>(scans, mission.ground_truth);
  };
  ModuleOptions options = module_options();
  options.engine.generation.skip_recent = 3;
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.computed > 10);
  REQUIRE(module.statistics().problems == 0);
  REQUIRE(module.graph().edges().size() > mission.graph.edges().size());
  parts.registrar = [](const ScanLoader&) { return std::shared_ptr<const Registrar>(); };
  REQUIRE_THROWS_AS(LoopClosureModule(mission.robots, options, {}, std::move(parts)), InputError);
}

TEST_CASE("module: finish makes a last estimate with all closures", "[online][module]") {
  const Mission mission = two_circles(1, 30);
  std::atomic<std::size_t> closures{0};
  std::size_t estimates = 0;  // of the module's thread, read after finish()
  ModuleCallbacks callbacks;
  callbacks.on_closure = [&](const LoopClosure&) { ++closures; };
  callbacks.on_estimate = [&](const std::shared_ptr<const Estimate>&) { ++estimates; };
  LoopClosureModule module(mission.robots, module_options(), callbacks, with_oracle(mission));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  while (closures == 0) std::this_thread::yield();
  module.finish();
  REQUIRE(estimates > 0);
  REQUIRE(module.estimate()->closures == closures);
  REQUIRE(module.statistics().optimizations == estimates);
  REQUIRE(module.statistics().candidates.in_flight == 0);
  REQUIRE_FALSE(module.add_candidates({pair(make_key('a', 1), make_key('b', 1))}));
  module.finish();
  module.stop();
  REQUIRE(module.estimate()->closures == closures);
}

TEST_CASE("module: estimates continue each other, the last one starts from scratch", "[online][module]") {
  const Mission mission = two_circles(1, 30);
  std::vector<bool> fresh;  // of each estimate; of the module's thread, read after finish()
  ModuleParts parts = with_oracle(mission);
  parts.on_event = [&](const HandledEvent& handled) {
    const auto* estimate = std::get_if<event::Optimized>(&handled.event);
    if (estimate != nullptr && !estimate->stopped) fresh.push_back(estimate->gnc.fresh);
  };
  ModuleOptions options = module_options();
  options.back_end.gnc.warm_growth = 1e9;
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) {
    REQUIRE(module.add_key_frame(frame));
    REQUIRE(module.wait());
  }
  module.finish();
  REQUIRE(fresh.size() > 2);
  REQUIRE(fresh.back());
  REQUIRE_FALSE(fresh[fresh.size() - 2]);  // without it, there would be nothing to make again
  REQUIRE(module.statistics().optimizations == fresh.size());
}

TEST_CASE("module: scans, factors and candidates may come before their nodes", "[online][module]") {
  const Mission mission = two_circles(1, 12);
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, {}, with_oracle(mission));
  const Key a = make_key('a', 11), b = make_key('b', 11);
  REQUIRE(module.add_candidates({pair(a, b), pair(b, a), pair(make_key('a', 9), b)}));
  std::vector<BetweenFactor> odometry;
  for (const Edge& edge : mission.graph.edges()) odometry.push_back(between(edge));
  REQUIRE(module.add_factors(factors(odometry, mission.graph.priors())));
  for (const Node& node : mission.graph.nodes())
    REQUIRE(module.add_scan(node.key, mission.scans->load(node.key)));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().factors_waiting == odometry.size() + mission.graph.priors().size());
  REQUIRE(module.statistics().candidates.waiting == 2);
  for (const Node& node : mission.graph.nodes()) {
    KeyFrame frame;
    frame.node = node;
    REQUIRE(module.add_key_frame(frame));
  }
  REQUIRE(module.wait());
  REQUIRE(module.statistics().factors_waiting == 0);
  REQUIRE(module.statistics().candidates.computed == 2);
  REQUIRE(module.graph().priors().size() == mission.graph.priors().size());
  REQUIRE(module.graph().edges().size() >= odometry.size());
}

TEST_CASE("module: odometry and priors give their nodes poses, in any order of arrival", "[online][module]") {
  const Mission mission = two_circles(1, 30);
  const std::vector<KeyFrame> frames = key_frames(mission);
  const auto pairs_of = [](const LoopClosureModule& module) {
    return module.statistics().candidates.generated;
  };
  ModuleOptions options = module_options("random");
  options.engine.use_back_end = false;
  options.engine.generation.skip_recent = 3;
  const auto make = [&] {
    return std::make_unique<LoopClosureModule>(mission.robots, options, ModuleCallbacks{},
                                               with_oracle(mission));
  };
  const auto in_order = make();
  for (const KeyFrame& frame : frames) REQUIRE(in_order->add_key_frame(frame));
  REQUIRE(in_order->wait());
  const PoseGraph expected = in_order->graph();

  struct Bare {
    std::vector<KeyFrame> frames;
    std::vector<std::vector<BetweenFactor>> factors;
    std::vector<PriorFactor> priors;
  } bare;
  for (KeyFrame frame : frames) {
    bare.factors.push_back(std::exchange(frame.odometry, {}));
    bare.priors.insert(bare.priors.end(), frame.priors.begin(), frame.priors.end());
    frame.priors.clear();
    frame.node.pose = Eigen::Isometry3d::Identity();  // as of a front end that leaves it to the odometry
    bare.frames.push_back(std::move(frame));
  }
  std::vector<BetweenFactor> odometry;
  for (const auto& factors : bare.factors) odometry.insert(odometry.end(), factors.begin(), factors.end());
  const std::vector<std::string> orders{
      "factors first",       "nodes first", "each factor before its node", "each factor after its node",
      "nodes last to first", "shuffled"};
  for (const std::string& order : orders) {
    CAPTURE(order);
    const auto module = make();
    if (order == "factors first") REQUIRE(module->add_factors(factors(odometry, bare.priors)));
    if (order == "nodes last to first") std::reverse(bare.frames.begin(), bare.frames.end());
    std::vector<std::size_t> numbers(bare.frames.size());
    std::iota(numbers.begin(), numbers.end(), std::size_t{0});
    if (order == "shuffled") Rng(4).shuffle(numbers);
    for (const std::size_t i : numbers) {
      if (order == "each factor before its node") REQUIRE(module->add_factors(factors(bare.factors[i])));
      REQUIRE(module->add_key_frame(bare.frames[i]));
      if (order == "each factor after its node" || order == "shuffled")
        REQUIRE(module->add_factors(factors(bare.factors[i])));
    }
    if (order.rfind("nodes", 0) == 0) {
      std::vector<BetweenFactor> shuffled = odometry;
      Rng(5).shuffle(shuffled);
      REQUIRE(module->add_factors(factors(shuffled, bare.priors)));
    } else if (order != "factors first") {
      REQUIRE(module->add_factors(factors({}, bare.priors)));
    }
    REQUIRE(module->wait());
    const PoseGraph graph = module->graph();
    REQUIRE(graph.nodes().size() == expected.nodes().size());
    for (const Node& node : expected.nodes()) {
      CAPTURE(key_name(node.key));
      REQUIRE(testing::difference(graph.node(node.key).pose, node.pose) < 1e-6);
    }
    REQUIRE(pairs_of(*module) >= pairs_of(*in_order));
    if (order == "factors first") REQUIRE(pairs_of(*module) == pairs_of(*in_order));
    if (order == "nodes last to first") std::reverse(bare.frames.begin(), bare.frames.end());
  }
}

namespace {

/// The truth for a task whose guess is within a metre of it, and no closure otherwise.
class GuessCheckingRegistrar final : public Registrar {
 public:
  explicit GuessCheckingRegistrar(const std::map<Key, Eigen::Isometry3d>& truth)
      : truth_(truth), oracle_(truth, 0.0, 0.0) {}
  [[nodiscard]] std::string_view name() const override { return "guess_checking"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    const LoopCandidate& c = task.candidate;
    const Eigen::Isometry3d truth = truth_.at(c.from).inverse() * truth_.at(c.to);
    if ((task.guess_from_to.value().translation() - truth.translation()).norm() < 1.0)
      return oracle_.compute(task);
    RegistrationResult result;
    result.candidate = c;
    result.reason = RejectionReason::kGicpFitness;
    return result;
  }

 private:
  std::map<Key, Eigen::Isometry3d> truth_;
  OracleRegistrar oracle_;
};

}  // namespace

TEST_CASE("module: pairs rejected at the former pose of a node are computed again", "[online][module]") {
  Mission mission = two_circles(1, 12);
  for (const Node& node : mission.graph.nodes()) mission.ground_truth[node.key] = node.pose;
  const std::vector<KeyFrame> frames = key_frames(mission);
  BetweenFactor tie;
  tie.from = make_key('a', 0);
  tie.to = make_key('b', 0);
  tie.T_from_to = mission.ground_truth.at(tie.from).inverse() * mission.ground_truth.at(tie.to);
  tie.information = 100.0 * Matrix6d::Identity();
  const Key a = make_key('a', 6), b = make_key('b', 6);
  for (const bool proximity : {false, true}) {
    for (const bool in_computation : {false, true}) {
      CAPTURE(proximity, in_computation);
      std::map<std::pair<Key, Key>, int> rejected, verified;  // read after wait()
      LoopClosureModule* module = nullptr;
      bool tied = false;
      ModuleCallbacks callbacks;
      callbacks.on_result = [&](const RegistrationResult& result) {
        ++(result.verified() ? verified : rejected)[std::minmax(result.candidate.from, result.candidate.to)];
        if (!in_computation || std::exchange(tied, true)) return;
        if (!module->add_factors(factors({tie}))) throw InputError("stopped");
      };
      ModuleOptions options = module_options("baseline");
      options.engine.use_back_end = false;
      options.engine.use_proximity = proximity;
      options.threads = 1;
      options.engine.generation.skip_recent = 3;
      ModuleParts parts;
      parts.registrar = given(std::make_shared<GuessCheckingRegistrar>(mission.ground_truth));
      LoopClosureModule running(mission.robots, options, callbacks, std::move(parts));
      module = &running;
      for (KeyFrame frame : frames) {
        frame.priors.clear();
        if (key_character(frame.node.key) == 'b') frame.node.pose.translation().z() += 2.0;
        REQUIRE(running.add_key_frame(frame));
      }
      if (!proximity) REQUIRE(running.add_candidates({pair(a, b), pair(a, b + 1)}));
      REQUIRE(running.wait());
      if (!in_computation) {
        REQUIRE(rejected[std::minmax(a, b)] == 1);
        REQUIRE(verified.count(std::minmax(a, b)) == 0);
        REQUIRE(running.add_factors(factors({tie})));
        REQUIRE(running.wait());
      }
      REQUIRE(testing::difference(running.graph().node(b).pose, mission.ground_truth.at(b)) < 1e-9);
      REQUIRE(verified[std::minmax(a, b)] == 1);
      REQUIRE(verified[std::minmax(a, b + 1)] == 1);
      for (const auto& [keys, times] : rejected) {
        CAPTURE(key_name(keys.first), key_name(keys.second));
        REQUIRE(times <= 2);  // once more at most: begun just before
        REQUIRE(verified.count(keys) == 1);
      }
      const CandidateAccounting account = running.statistics().candidates;
      REQUIRE(account.balanced());
      REQUIRE(account.computed == account.generated);
    }
  }
}

TEST_CASE("module: a robot that starts in an unknown frame joins when its frame is found",
          "[online][module][joining]") {
  const Mission mission = two_circles();
  Eigen::Isometry3d T_own_world = Eigen::Isometry3d::Identity();
  T_own_world.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 2.0));
  T_own_world.translation() = Eigen::Vector3d(70.0, -40.0, 1.0);
  LoopClosureModule module(mission.robots, module_options("baseline"), {}, with_oracle(mission));
  const Key first = make_key('b', 0);
  for (KeyFrame frame : key_frames(mission)) {
    if (key_character(frame.node.key) == 'b') {
      frame.node.pose = T_own_world * frame.node.pose;
      frame.priors.clear();
    }
    REQUIRE(module.add_key_frame(frame));
  }
  REQUIRE(module.wait());
  const auto between_robots = [&] {
    const PoseGraph graph = module.graph();
    return std::count_if(graph.edges().begin(), graph.edges().end(), [&](const Edge& edge) {
      return mission.robots.of(edge.from) != mission.robots.of(edge.to);
    });
  };
  // The module proposes nothing between robots that seem to be far apart.
  REQUIRE(between_robots() == 0);
  const PoseGraph apart = module.graph();
  REQUIRE((apart.node(first).pose.translation() - mission.ground_truth.at(first).translation()).norm() >
          50.0);

  std::vector<JoinComponent> components{{"a", {}}, {"b", {}}};
  for (const Node& node : apart.nodes()) components[mission.robots.of(node.key)].keys.push_back(node.key);
  ThreadPool threads(2);
  const JoinResult found =
      find_frames(apart, mission.robots, components, {}, OracleRegistrar(mission.ground_truth), threads);
  CAPTURE(to_string(found, components));
  REQUIRE(found.groups == 1);
  PriorFactor start;
  start.key = first;
  start.pose = found.frames[1].pose * apart.node(first).pose;
  start.information = (100.0 * found.frames[1].covariance).inverse();
  start.information = 0.5 * (start.information + start.information.transpose()).eval();
  REQUIRE(module.add_factors(factors({}, {start})));
  REQUIRE(module.wait());
  REQUIRE(between_robots() > 50);
  REQUIRE(mean_error(mission, module.graph()) < 0.2 * mean_error(mission, mission.graph));
}

TEST_CASE("module: odometry that arrives during an optimisation is included in the end", "[online][module]") {
  const Mission mission = two_circles(1, 30);
  // Only the second part of robot a has a known place, and only it has closures, which move it. The odometry
  // between both parts may arrive late; until then the first part is not fixed.
  const Key joint = make_key('a', 12);
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 12; i < 30; i += 3) candidates.push_back(pair(make_key('a', i), make_key('b', i)));
  BetweenFactor held;
  const auto run = [&](bool hold, double off_m) {
    LoopClosureModule* module = nullptr;
    std::size_t results = 0;
    ModuleCallbacks callbacks;
    callbacks.on_result = [&](const RegistrationResult&) {
      if (++results < candidates.size() || !hold) return;
      // After the end of the batch, at which the back end starts, and before its estimate.
      while (module->statistics().events_waiting == 0) std::this_thread::yield();
      if (!module->add_factors(factors({held}))) throw InputError("stopped");
    };
    ModuleOptions options = module_options("baseline");
    options.engine.use_proximity = false;
    ModuleParts parts;
    parts.registrar = given(std::make_shared<OracleRegistrar>(mission.ground_truth, 0.0, 0.0));
    LoopClosureModule running(mission.robots, options, callbacks, std::move(parts));
    module = &running;
    for (KeyFrame frame : key_frames(mission)) {
      if (frame.node.key == make_key('a', 0)) frame.priors.clear();
      if (frame.node.key == joint) {
        PriorFactor prior;
        prior.key = joint;
        prior.pose = Eigen::Translation3d(off_m, off_m, 0.0) * frame.node.pose;
        prior.information = 0.1 * Matrix6d::Identity();
        frame.priors.push_back(prior);
        held = frame.odometry.front();
        if (hold) frame.odometry.clear();
      }
      REQUIRE(running.add_key_frame(frame));
    }
    REQUIRE(running.wait());
    REQUIRE(running.add_candidates(candidates));
    REQUIRE(running.wait());
    REQUIRE(results == candidates.size());
    return running.graph();
  };
  for (const double off_m : {1.0, 0.0}) {  // with 0, the late edge agrees with the poses
    const PoseGraph late = run(true, off_m), expected = run(false, off_m);
    for (const Node& node : expected.nodes()) {
      CAPTURE(off_m, key_name(node.key));
      REQUIRE(testing::difference(late.node(node.key).pose, node.pose) < 1e-3);
    }
  }
}

TEST_CASE("module: a prior that arrives during an optimisation does not discard its estimate",
          "[online][module]") {
  const Mission mission = two_circles(1, 12);
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 0; i < 12; i += 2) candidates.push_back(pair(make_key('b', i), make_key('a', i)));
  // The front end places robot b wrongly, and a weak prior may come late with the same pose.
  const auto run = [&](bool late) {
    LoopClosureModule* module = nullptr;
    PriorFactor prior;
    std::size_t results = 0;
    ModuleCallbacks callbacks;
    callbacks.on_result = [&](const RegistrationResult&) {
      if (++results < candidates.size() || !late) return;
      // After the end of the batch, at which the back end starts, and before its estimate.
      while (module->statistics().events_waiting == 0) std::this_thread::yield();
      if (!module->add_factors(factors({}, {prior}))) throw InputError("stopped");
    };
    ModuleOptions options = module_options("baseline");
    options.engine.use_proximity = false;
    ModuleParts parts;
    parts.registrar = given(std::make_shared<OracleRegistrar>(mission.ground_truth, 0.0, 0.0));
    LoopClosureModule running(mission.robots, options, callbacks, std::move(parts));
    module = &running;
    for (KeyFrame frame : key_frames(mission)) {
      if (frame.node.key == make_key('b', 0)) {
        frame.node.pose = Eigen::Translation3d(1.0, 1.0, 0.0) * frame.node.pose;
        prior.key = frame.node.key;
        prior.pose = frame.node.pose;
        prior.information = 0.1 * Matrix6d::Identity();
        frame.priors.clear();
        if (!late) frame.priors.push_back(prior);
      }
      REQUIRE(running.add_key_frame(frame));
    }
    REQUIRE(running.wait());
    REQUIRE(running.add_candidates(candidates));
    REQUIRE(running.wait());
    REQUIRE(results == candidates.size());
    return running.graph();
  };
  const PoseGraph late = run(true), expected = run(false);
  for (const Node& node : expected.nodes()) {
    CAPTURE(key_name(node.key));
    REQUIRE(testing::difference(late.node(node.key).pose, node.pose) < 1e-3);
  }
  REQUIRE((expected.node(make_key('b', 0)).pose.translation() -
           mission.ground_truth.at(make_key('b', 0)).translation())
              .norm() < 0.2);
}

TEST_CASE("module: odometry that arrives separately from its node requests no estimate", "[online][module]") {
  const Mission mission = two_circles(1, 12);
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 0; i < 11; i += 2) candidates.push_back(pair(make_key('b', i), make_key('a', i)));
  LoopClosureModule* module = nullptr;
  std::vector<BetweenFactor> held;
  std::size_t results = 0;
  ModuleCallbacks callbacks;
  callbacks.on_result = [&](const RegistrationResult&) {
    if (++results < candidates.size()) return;
    // After the end of the batch, at which the back end starts, and before its estimate.
    while (module->statistics().events_waiting == 0) std::this_thread::yield();
    if (!module->add_factors(factors(held))) throw InputError("stopped");
  };
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  options.threads = static_cast<int>(candidates.size());  // so that one batch has all of them
  LoopClosureModule running(mission.robots, options, callbacks, with_oracle(mission));
  module = &running;
  for (KeyFrame frame : key_frames(mission)) {
    if (frame.node.key == make_key('b', 0)) {
      frame.node.pose = Eigen::Translation3d(1.0, 1.0, 0.0) * frame.node.pose;
      frame.priors.clear();
    }
    if (frame.node.key == make_key('b', 11)) held.swap(frame.odometry);
    REQUIRE(running.add_key_frame(frame));
  }
  REQUIRE(held.size() == 1);
  REQUIRE(running.wait());
  REQUIRE(running.add_candidates(candidates));
  REQUIRE(running.wait());
  REQUIRE(results == candidates.size());
  REQUIRE(running.statistics().optimizations == 1);
  const PoseGraph graph = running.graph();
  const BetweenFactor& edge = held.front();
  REQUIRE(testing::difference(graph.node(edge.from).pose * edge.T_from_to, graph.node(edge.to).pose) < 1e-6);
}

TEST_CASE("module: a prior of the position alone does not turn the path", "[online][module]") {
  const Mission mission = two_circles(1, 10);
  ModuleOptions options = module_options("odom");
  options.engine.use_back_end = false;  // which would fit the path to the prior
  LoopClosureModule module(mission.robots, options, {}, with_oracle(mission));
  for (KeyFrame frame : key_frames(mission)) {
    frame.priors.clear();
    REQUIRE(module.add_key_frame(frame));
  }
  REQUIRE(module.wait());
  const PoseGraph before = module.graph();
  PriorFactor position;
  position.key = make_key('a', 6);
  position.pose.translation() << 100.0, 0.0, 0.0;
  position.information.setZero();
  position.information.diagonal().head<3>().setConstant(4.0);
  REQUIRE(module.add_factors(factors({}, {position})));
  REQUIRE(module.wait());
  const PoseGraph still = module.graph();
  for (const Node& node : still.nodes()) {
    REQUIRE(node.pose.matrix() == before.node(node.key).pose.matrix());
  }
  position.information.setIdentity();
  REQUIRE(module.add_factors(factors({}, {position})));
  REQUIRE(module.wait());
  const PoseGraph after = module.graph();
  REQUIRE(after.node(position.key).pose.matrix() == position.pose.matrix());
  REQUIRE(after.node(make_key('b', 6)).pose.matrix() == before.node(make_key('b', 6)).pose.matrix());
  const auto step = [](const PoseGraph& graph) {
    return (graph.node(make_key('a', 0)).pose.inverse() * graph.node(make_key('a', 9)).pose).matrix().eval();
  };
  REQUIRE((step(after) - step(before)).cwiseAbs().maxCoeff() < 1e-9);
}

TEST_CASE("module: fly-bys of a radio beacon become candidates, in any order of arrival",
          "[online][module]") {
  const Mission mission = two_circles(1, 40);
  ModuleOptions options = module_options("rssi");
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, {}, with_oracle(mission));
  // Robot a drops a beacon at its node 5; robot b passes it at its nodes 4 to 6.
  std::vector<RadioReading> readings;
  for (std::uint64_t i = 0; i < 40; ++i) {
    RadioReading reading;
    reading.key = make_key('b', i);
    reading.beacon = "b1";
    reading.transmit_dbm = 28.0;
    reading.receive_dbm = i >= 4 && i <= 6 ? -20.0 : -80.0;
    readings.push_back(reading);
  }
  REQUIRE(module.add_radio(readings));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.generated == 0);
  BeaconDrop drop;
  drop.beacon = "b1";
  drop.robot = 0;
  drop.drop_key = make_key('a', 5);
  REQUIRE(module.add_beacon_drop(drop));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.computed == 3);
  REQUIRE_THROWS_AS(module.add_radio({RadioReading()}), UnknownKeyError);
}

TEST_CASE("module: factors to nodes that never come are dropped in the end, and counted",
          "[online][module]") {
  const Mission mission = two_circles(1, 40);
  ModuleOptions options = module_options("odom");
  options.engine.max_factor_wait_s = 10.0;
  std::vector<std::string> problems;
  ModuleCallbacks callbacks;
  callbacks.on_problem = [&](const std::string& text) { problems.push_back(text); };
  const auto clock = std::make_shared<ManualClock>();
  ModuleParts parts = with_oracle(mission);
  parts.clock = clock;
  LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
  BetweenFactor lost = between(mission.graph.edges()[0]);
  lost.from = make_key('a', 1000);
  REQUIRE(module.add_factors(factors({lost})));
  std::vector<KeyFrame> frames = key_frames(mission);
  // A robot's clock that is wrong by days must not drop factors: waiting is measured by the module's own
  // clock.
  for (std::size_t i = 0; i + 1 < frames.size(); ++i) {
    if (key_character(frames[i].node.key) == 'b')
      frames[i].node.stamp_ns += 200000 * std::int64_t{1000000000};
    REQUIRE(module.add_key_frame(frames[i]));
  }
  REQUIRE(module.wait());
  REQUIRE(module.statistics().factors_dropped == 0);
  REQUIRE(module.statistics().factors_waiting == 1);
  clock->now_s = 10.5;
  REQUIRE(module.add_key_frame(frames.back()));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().factors_dropped == 1);
  REQUIRE(module.statistics().factors_waiting == 0);
  REQUIRE(problems.size() == 1);
  REQUIRE_THAT(problems[0], Contains(key_name(lost.from)));
}

TEST_CASE("module: bad input throws in the call, and nothing is stored", "[online][module]") {
  const Mission mission = two_circles(1, 5);
  LoopClosureModule module(mission.robots, module_options(), {}, with_oracle(mission));
  const std::vector<KeyFrame> frames = key_frames(mission);
  REQUIRE(module.add_key_frame(frames[0]));
  REQUIRE_THROWS_AS(module.add_key_frame(frames[0]), InputError);
  REQUIRE_THROWS_AS(module.add_scan(frames[0].node.key, frames[0].cloud), InputError);
  REQUIRE_THROWS_AS(module.add_scan(frames[1].node.key, nullptr), InputError);
  KeyFrame bad = frames[1];
  bad.node.pose.translation().x() = std::nan("");
  REQUIRE_THROWS_AS(module.add_key_frame(bad), InputError);
  bad = frames[1];
  bad.node.key = make_key('z', 0);
  REQUIRE_THROWS_AS(module.add_key_frame(bad), UnknownKeyError);
  bad = frames[2];
  bad.odometry.at(0).information(0, 0) = -1.0;
  REQUIRE_THROWS_AS(module.add_key_frame(bad), InputError);
  bad = frames[2];
  bad.odometry.at(0).from = bad.node.key;
  REQUIRE_THROWS_AS(module.add_key_frame(bad), InputError);
  bad = frames[1];
  auto cloud = std::make_shared<PointCloud>(*bad.cloud);
  cloud->points[3].z() = std::numeric_limits<float>::infinity();
  bad.cloud = cloud;
  REQUIRE_THROWS_AS(module.add_key_frame(bad), InputError);
  REQUIRE_THROWS_AS(module.add_candidates({pair(1, 1)}), UnknownKeyError);
  REQUIRE_THROWS_AS(module.add_candidates({pair(frames[0].node.key, frames[0].node.key)}), InputError);
  REQUIRE_THROWS_AS(module.set_estimate({}), InputError);  // our back end is on
  for (std::size_t i = 1; i < frames.size(); ++i)
    REQUIRE(module.add_key_frame(frames[i]));  // the good ones go in
  REQUIRE(module.wait());
  REQUIRE(module.graph().nodes().size() == frames.size());
  REQUIRE_THROWS_AS(LoopClosureModule(mission.robots, module_options("nonsense")), OptionError);
  ModuleOptions options = module_options();
  options.batch = 0;
  REQUIRE_THROWS_AS(LoopClosureModule(mission.robots, options), OptionError);
}

TEST_CASE("module: with another back end, poses come from outside and later nodes move along",
          "[online][module]") {
  const Mission mission = two_circles(1, 20);
  ModuleOptions options = module_options();
  options.engine.use_back_end = false;
  std::vector<std::shared_ptr<const Estimate>> estimates;
  ModuleCallbacks callbacks;
  callbacks.on_estimate = [&](const std::shared_ptr<const Estimate>& e) { estimates.push_back(e); };
  LoopClosureModule module(mission.robots, options, callbacks, with_oracle(mission));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(estimates.empty());
  const PoseGraph before = module.graph();

  ExternalEstimate estimate;
  const Key named = make_key('a', 10);
  const Eigen::Isometry3d shift(Eigen::Translation3d(0.0, 0.0, 5.0));
  estimate.poses[named] = shift * before.node(named).pose;
  estimate.covariances[named] = 0.5 * Matrix6d::Identity();
  estimate.poses[make_key('a', 999)] = Eigen::Isometry3d::Identity();  // a node that has not come: left out
  REQUIRE(module.set_estimate(estimate));
  REQUIRE(module.wait());
  REQUIRE(estimates.size() == 1);
  const PoseGraph after = module.graph();
  for (const Node& node : after.nodes()) {
    const bool moved = key_character(node.key) == 'a' && key_index(node.key) >= 10;
    REQUIRE((node.pose.translation() - before.node(node.key).pose.translation()).z() ==
            Approx(moved ? 5.0 : 0.0).margin(1e-9));
  }
  REQUIRE(after.node(named).covariance->isApprox(0.5 * Matrix6d::Identity()));
  // Of a back end that writes six digits; and of one that is wrong.
  estimate.poses[named].linear() *= 1.0 + 1e-6;
  REQUIRE(module.set_estimate(estimate));
  REQUIRE(module.wait());
  REQUIRE(estimates.size() == 2);
  estimate.poses[named].linear() *= 1.01;
  REQUIRE_THROWS_WITH(module.set_estimate(estimate), Contains("a10") && Contains("no"));
  estimate.poses[named].translation().x() = std::nan("");
  REQUIRE_THROWS_AS(module.set_estimate(estimate), InputError);
}

TEST_CASE("module: a closure that is taken out stays out", "[online][module]") {
  const Mission mission = two_circles(1, 12);
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, {}, [&] {
    ModuleParts parts;
    parts.registrar = given(std::make_shared<OracleRegistrar>(mission.ground_truth, 0.0, 0.0));
    return parts;
  }());
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  const Key a = make_key('a', 5), b = make_key('b', 5);
  REQUIRE(module.add_candidates({pair(a, b), pair(make_key('a', 9), make_key('b', 9))}));
  REQUIRE(module.wait());
  REQUIRE(module.graph().edges().size() == mission.graph.edges().size() + 2);
  REQUIRE(module.estimate()->closures == 2);
  REQUIRE(module.remove_closure(b, a));
  REQUIRE(module.wait());
  REQUIRE(module.graph().edges().size() == mission.graph.edges().size() + 1);
  REQUIRE(module.estimate()->closures == 1);
  REQUIRE(module.add_candidates({pair(a, b)}));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.computed == 2);
}

namespace {

/// Holds every registration until it is opened.
class GatedRegistrar final : public Registrar {
 public:
  explicit GatedRegistrar(std::map<Key, Eigen::Isometry3d> truth) : oracle_(std::move(truth), 0.0, 0.0) {}
  [[nodiscard]] std::string_view name() const override { return "gated"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    std::unique_lock<std::mutex> lock(mutex_);
    ++begun_;
    changed_.notify_all();
    changed_.wait(lock, [this] { return open_; });
    return oracle_.compute(task);
  }
  void open() {
    const std::lock_guard<std::mutex> lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }
  void wait_for_first() const {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return begun_ > 0; });
  }

 private:
  OracleRegistrar oracle_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  mutable int begun_ = 0;
  bool open_ = false;
};

/// Improves until it is stopped, and records its calls.
class EndlessPrioritizer final : public Prioritizer {
 public:
  struct Log {
    std::mutex mutex;
    std::condition_variable changed;
    int improving = 0;
    std::vector<std::string> calls;
    void wait_for_improvement() {
      std::unique_lock<std::mutex> lock(mutex);
      changed.wait(lock, [this] { return improving > 0; });
    }
  };
  explicit EndlessPrioritizer(std::shared_ptr<Log> log) : log_(std::move(log)) {}
  [[nodiscard]] std::string_view name() const override { return "endless"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    write("add");
    return arrival_.add(candidates);
  }
  void remove(const std::vector<CandidateId>& ids) override { arrival_.remove(ids); }
  std::uint64_t improve(std::size_t, const StopToken& stop, std::uint64_t) override {
    {
      const std::lock_guard<std::mutex> lock(log_->mutex);
      ++log_->improving;
      log_->calls.emplace_back("improve");
      log_->changed.notify_all();
    }
    while (!stop.stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return 0;
  }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override {
    write("take");
    return arrival_.take(count);
  }
  [[nodiscard]] std::size_t size() const override { return arrival_.size(); }

 private:
  void write(const std::string& call) {
    const std::lock_guard<std::mutex> lock(log_->mutex);
    if (log_->calls.empty() || log_->calls.back() != call) log_->calls.push_back(call);
  }
  std::shared_ptr<Log> log_;
  ArrivalPrioritizer arrival_;
};

/// Takes its time for each addition.
class SlowPrioritizer final : public Prioritizer {
 public:
  [[nodiscard]] std::string_view name() const override { return "slow"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    return arrival_.add(candidates);
  }
  void remove(const std::vector<CandidateId>& ids) override { arrival_.remove(ids); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return arrival_.take(count); }
  [[nodiscard]] std::size_t size() const override { return arrival_.size(); }

 private:
  ArrivalPrioritizer arrival_;
};

}  // namespace

TEST_CASE("module: a failing prioritiser is reported and does not stop the others",
          "[online][module][error]") {
  const Mission mission = two_circles(1, 12);
  ModuleParts parts = with_oracle(mission);
  CallbackPrioritizer::Callbacks calls;
  calls.scan = [](Key key) {
    if (key == make_key('a', 3)) throw std::runtime_error("no scan");
  };
  calls.graph = [] { throw std::runtime_error("no graph"); };
  parts.prioritizers.push_back(std::make_unique<CallbackPrioritizer>(calls));
  LoopClosureModule module(mission.robots, module_options(), {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  const ModuleStatistics statistics = module.statistics();
  REQUIRE(statistics.candidates.balanced());
  REQUIRE(statistics.candidates.computed > 20);
  REQUIRE(statistics.candidates.computed == statistics.candidates.generated);
  // Counted and kept without a callback, too.
  REQUIRE(statistics.problems > 1);
  REQUIRE(statistics.last_problems.size() == std::min<std::size_t>(statistics.problems, 20));
  for (const std::string& problem : statistics.last_problems) {
    CAPTURE(problem);
    const bool named = problem == "prioritisation: callback: on_graph(): no graph" ||
                       problem == "prioritisation: callback: on_scan(): no scan";
    REQUIRE(named);
  }
}

TEST_CASE("module: without memory it stops with one problem, and stays readable", "[online][module][error]") {
  const Mission mission = two_circles(1, 12);
  const std::vector<KeyFrame> frames = key_frames(mission);
  ModuleParts parts = with_oracle(mission);
  CallbackPrioritizer::Callbacks calls;
  calls.scan = [&](Key key) {
    if (key == frames[8].node.key) throw std::bad_alloc();
  };
  parts.prioritizers.push_back(std::make_unique<CallbackPrioritizer>(calls));
  std::vector<std::string> problems;
  ModuleCallbacks callbacks;
  callbacks.on_problem = [&](const std::string& text) { problems.push_back(text); };
  ModuleOptions options = module_options();
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
  for (const KeyFrame& frame : frames) static_cast<void>(module.add_key_frame(frame));
  REQUIRE_FALSE(module.wait());
  REQUIRE_FALSE(module.remove_closure(frames[0].node.key, frames[1].node.key));
  REQUIRE(module.graph().nodes().size() == 9);
  REQUIRE(module.statistics().candidates.balanced());
  module.stop();
  REQUIRE(problems == std::vector<std::string>{"out of memory: the module has stopped"});
}

TEST_CASE("module: improves the next set during the computation, stops with it, keeps new candidates",
          "[online][module]") {
  const Mission mission = two_circles(1, 12);
  const auto log = std::make_shared<EndlessPrioritizer::Log>();
  const auto registrar = std::make_shared<GatedRegistrar>(mission.ground_truth);
  ModuleParts parts;
  parts.registrar = given(registrar);
  parts.prioritizers.push_back(std::make_unique<EndlessPrioritizer>(log));
  ModuleOptions options = module_options();
  options.engine.use_proximity = false;
  options.batch = 2;
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  const auto candidate = [](std::uint64_t i) { return pair(make_key('a', i), make_key('b', i)); };
  REQUIRE(module.add_candidates({candidate(0), candidate(1), candidate(2), candidate(3), candidate(4)}));
  registrar->wait_for_first();
  log->wait_for_improvement();  // the first batch is held in the computation
  REQUIRE(module.add_candidates({candidate(5)}));
  while (module.statistics().events_waiting == 0) std::this_thread::yield();
  {
    const std::lock_guard<std::mutex> lock(log->mutex);
    REQUIRE(log->calls == std::vector<std::string>{"add", "take", "improve"});  // the late one is kept
  }
  registrar->open();
  REQUIRE(module.wait());
  const std::lock_guard<std::mutex> lock(log->mutex);
  // Each of the two results interrupts the improvement, which may begin again in between.
  std::vector<std::string> calls = log->calls;
  calls.erase(std::unique(calls.begin(), calls.end()), calls.end());
  REQUIRE(calls.size() >= 5);
  calls.resize(5);
  REQUIRE(calls == std::vector<std::string>{"add", "take", "improve", "take", "add"});
  REQUIRE(module.statistics().candidates.computed == 6);
}

TEST_CASE("module: statistics are available under overload", "[online][module]") {
  const Mission mission = two_circles(1, 30);
  ModuleParts parts = with_oracle(mission);
  parts.prioritizers.push_back(std::make_unique<SlowPrioritizer>());
  ModuleOptions options = module_options();
  options.queue_capacity = 4;
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  for (std::uint64_t i = 0; i < 10; ++i) {
    for (std::uint64_t j = 0; j < 20; ++j)
      REQUIRE(module.add_candidates({pair(make_key('a', i), make_key('b', j))}));
  }
  // All events were handled, except those that the queues can hold.
  REQUIRE(module.statistics().candidates.generated >= 150);
  REQUIRE(module.statistics().candidates.balanced());
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.generated == 200);
}

TEST_CASE("module: a full queue blocks its producer and drops nothing; callbacks may add",
          "[online][module]") {
  const Mission mission = two_circles(1, 30);
  ModuleOptions options = module_options("baseline");
  options.queue_capacity = 1;
  options.engine.use_proximity = false;
  LoopClosureModule* self = nullptr;
  std::atomic<int> echoed{0};
  ModuleCallbacks callbacks;
  callbacks.on_result = [&](const RegistrationResult& result) {
    if (echoed.fetch_add(1) == 0) {  // from within, with the queue as full as may be
      for (std::uint64_t i = 0; i < 5; ++i) {
        REQUIRE(self->add_candidates({pair(result.candidate.from, make_key('b', 20 + i))}));
      }
      throw std::runtime_error("a user's mistake");
    }
  };
  std::vector<std::string> problems;
  callbacks.on_problem = [&](const std::string& text) { problems.push_back(text); };
  LoopClosureModule module(mission.robots, options, callbacks, with_oracle(mission));
  self = &module;
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(module.add_candidates({pair(make_key('a', 3), make_key('b', 3))}));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.computed == 6);
  REQUIRE(module.graph().nodes().size() == mission.graph.nodes().size());
  REQUIRE(problems == std::vector<std::string>{"callback on_result: a user's mistake"});
}

namespace {

/// Does not return from one pair until it is released.
class HangingRegistrar final : public Registrar {
 public:
  HangingRegistrar(std::map<Key, Eigen::Isometry3d> truth, Key hangs_from)
      : oracle_(std::move(truth), 0.0, 0.0), hangs_from_(hangs_from) {}
  [[nodiscard]] std::string_view name() const override { return "hanging"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    while (task.candidate.from == hangs_from_ && !released_)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return oracle_.compute(task);
  }
  void release() { released_ = true; }

 private:
  OracleRegistrar oracle_;
  const Key hangs_from_;
  std::atomic<bool> released_{false};
};

}  // namespace

TEST_CASE("module: a registration that hangs is reported, the others continue, and its result still counts",
          "[online][module][error]") {
  const Mission mission = two_circles(1, 12);
  const int batch = GENERATE(1, 3);
  const int threads = GENERATE(1, 2);           // with one, none is left beside it
  const bool released = GENERATE(true, false);  // before the stop, or while it waits
  CAPTURE(batch, threads, released);
  const auto registrar = std::make_shared<HangingRegistrar>(mission.ground_truth, make_key('b', 2));
  ModuleParts parts;
  parts.registrar = given(registrar);
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  options.batch = batch;
  options.threads = threads;
  options.overdue_after_s = 0.05;
  std::mutex mutex;
  std::vector<std::string> problems;
  ModuleCallbacks callbacks;
  callbacks.on_problem = [&](const std::string& text) {
    const std::lock_guard<std::mutex> lock(mutex);
    problems.push_back(text);
  };
  LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 0; i < 10; ++i) candidates.push_back(pair(make_key('a', i), make_key('b', i)));
  REQUIRE(module.add_candidates(candidates));
  const auto account = [&] { return module.statistics().candidates; };
  // On a busy machine others may be overdue too, but they return.
  const auto is_reported = [&] {
    const std::lock_guard<std::mutex> lock(mutex);
    return std::any_of(problems.begin(), problems.end(), [](const std::string& text) {
      return (Contains("b2") && Contains("a2") && Contains("is still running")).match(text);
    });
  };
  for (int i = 0;
       i < 60000 && !(account().computed == 9 && module.statistics().overdue_now == 1 && is_reported()); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  REQUIRE(account().computed == 9);
  REQUIRE(account().in_flight == 1);
  REQUIRE(account().balanced());
  REQUIRE(module.statistics().overdue >= 1);
  REQUIRE(module.statistics().overdue_now == 1);
  REQUIRE(is_reported());
  if (released) {
    registrar->release();
    REQUIRE(module.wait());
    REQUIRE(module.statistics().overdue_now == 0);
    REQUIRE(module.estimate()->closures == 10);
    module.stop();
  } else {
    std::thread later([&] {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      registrar->release();
    });
    module.stop();
    later.join();
  }
  REQUIRE(account().computed == 10);
  REQUIRE(account().in_flight == 0);
  REQUIRE(module.graph().edges().size() == mission.graph.edges().size() + 10);
}

namespace {

/// A registrar with faults: it stalls at times, rejects most pairs, and throws at times.
class FaultyRegistrar final : public Registrar {
 public:
  explicit FaultyRegistrar(std::atomic<std::size_t>& computed) : computed_(computed) {}
  [[nodiscard]] std::string_view name() const override { return "faulty"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    ++computed_;
    Rng rng(task.seed);
    if (rng.uniform() < 0.01) std::this_thread::sleep_for(std::chrono::milliseconds(2));
    if (rng.uniform() < 0.01) throw std::runtime_error("faulty");
    RegistrationResult result;
    result.candidate = task.candidate;
    if (rng.uniform() < 0.99 || !task.guess_from_to) {
      result.reason = RejectionReason::kFewMatches;
      return result;
    }
    LoopClosure closure;
    closure.from = task.candidate.from;
    closure.to = task.candidate.to;
    closure.T_from_to = *task.guess_from_to;
    closure.covariance = 1e-2 * Matrix6d::Identity();
    result.closure = closure;
    return result;
  }

 private:
  std::atomic<std::size_t>& computed_;
};

}  // namespace

TEST_CASE("module: four producers, ten thousand key frames, stalls: nothing is lost",
          "[online][module][stress]") {
  constexpr std::size_t kProducers = 4, kFrames = 2500;
  const Robots robots = parse_robots("a,b,c,d");
  std::atomic<std::size_t> computed{0};
  ModuleOptions options = module_options("random");
  options.queue_capacity = 64;
  options.batch = 100;
  options.engine.generation.radius_min_m = options.engine.generation.radius_max_m = 3.0;
  options.engine.generation.n_closest = 2;
  std::size_t results = 0;
  ModuleCallbacks callbacks;
  callbacks.on_result = [&](const RegistrationResult&) { ++results; };
  ModuleParts parts;
  parts.registrar = given(std::make_shared<FaultyRegistrar>(computed));
  LoopClosureModule module(robots, options, callbacks, std::move(parts));
  const auto cloud = std::make_shared<const PointCloud>(PointCloud{{Eigen::Vector3f::UnitX()}, {}, {}});
  std::atomic<std::size_t> taken{0};
  std::vector<std::thread> producers;
  for (std::size_t p = 0; p < kProducers; ++p) {
    producers.emplace_back([&, p] {
      Rng rng(p);
      const char robot = static_cast<char>('a' + p);
      BetweenFactor edge;
      for (std::uint64_t i = 0; i < kFrames; ++i) {
        KeyFrame frame;
        frame.node.key = make_key(robot, i);
        frame.node.stamp_ns = static_cast<std::int64_t>(i) * 1'000'000'000;
        frame.node.pose.translation() << 100.0 * std::cos(0.02 * static_cast<double>(i)),
            100.0 * std::sin(0.02 * static_cast<double>(i)), 2.0 * static_cast<double>(p);
        if (i > 0) {
          edge.from = make_key(robot, i - 1);
          edge.to = frame.node.key;
          edge.T_from_to.setIdentity();
          edge.T_from_to.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 0.02));
          edge.T_from_to.translation().x() = 2.0;
        }
        // All at once, or piece by piece in any order.
        const double way = rng.uniform();
        if (i > 0 && way < 0.5) frame.odometry = {edge};
        if (way < 0.7) frame.cloud = cloud;
        if (i > 0 && way >= 0.75) taken += module.add_factors(factors({edge})) ? 0 : 1;
        if (way >= 0.85) taken += module.add_scan(frame.node.key, cloud) ? 0 : 1;
        taken += module.add_key_frame(frame) ? 1 : 0;
        if (i > 0 && way >= 0.5 && way < 0.75) taken += module.add_factors(factors({edge})) ? 0 : 1;
        if (way >= 0.7 && way < 0.85) taken += module.add_scan(frame.node.key, cloud) ? 0 : 1;
        if (rng.uniform() < 0.02 && i > 20) {
          static_cast<void>(
              module.add_candidates({pair(frame.node.key, make_key(robot, rng.below(i - 10)))}));
        }
        if (rng.uniform() < 0.001) std::this_thread::sleep_for(std::chrono::milliseconds(3));
        if (rng.uniform() < 0.001) static_cast<void>(module.graph());
        if (rng.uniform() < 0.01) static_cast<void>(module.statistics());
      }
    });
  }
  for (std::thread& producer : producers) producer.join();
  REQUIRE(taken == kProducers * kFrames);
  REQUIRE(module.wait());
  const ModuleStatistics statistics = module.statistics();
  REQUIRE(statistics.candidates.balanced());
  REQUIRE(statistics.candidates.generated > kFrames);
  REQUIRE(statistics.candidates.computed == statistics.candidates.generated);
  REQUIRE(results == computed);
  REQUIRE(computed == statistics.candidates.computed);
  const PoseGraph graph = module.graph();
  REQUIRE(graph.nodes().size() == kProducers * kFrames);
  std::size_t odometry = 0;
  for (const Edge& edge : graph.edges()) odometry += edge.kind == EdgeKind::kOdometry ? 1 : 0;
  REQUIRE(odometry == kProducers * (kFrames - 1));
}

TEST_CASE("module: a stop at any time loses no accepted event", "[online][module][stress]") {
  const Mission mission = two_circles(1, 40);
  const std::vector<KeyFrame> frames = key_frames(mission);
  for (std::uint64_t trial = 0; trial < 40; ++trial) {
    CAPTURE(trial);
    std::atomic<std::size_t> computed{0}, taken{0};
    std::size_t results = 0;
    ModuleOptions options = module_options(trial % 2 == 0 ? "random" : "baseline");
    options.queue_capacity = 4;
    ModuleCallbacks callbacks;
    callbacks.on_result = [&](const RegistrationResult&) { ++results; };
    ModuleParts parts;
    parts.registrar = given(std::make_shared<FaultyRegistrar>(computed));
    LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
    std::vector<std::thread> producers;
    for (std::size_t p = 0; p < 2; ++p) {
      producers.emplace_back([&, p] {
        for (const KeyFrame& frame : frames) {
          if (mission.robots.of(frame.node.key) != p) continue;
          if (!module.add_key_frame(frame)) return;
          ++taken;
        }
      });
    }
    std::this_thread::sleep_for(std::chrono::microseconds(Rng(trial).below(20000)));
    module.stop();
    for (std::thread& producer : producers) producer.join();
    const ModuleStatistics statistics = module.statistics();
    REQUIRE(module.graph().nodes().size() == taken);
    REQUIRE(statistics.candidates.balanced());
    REQUIRE(statistics.candidates.in_flight == 0);
    REQUIRE(statistics.candidates.computed == results);
    REQUIRE(results == computed);
  }
}

namespace {

/// The component folders of all headers of the library that this one includes, directly or not.
std::set<std::string> components_behind(const std::string& header) {
  const testing::fs::path root = testing::fs::path(LOOPWISE_SOURCE_DIR) / "include";
  std::set<std::string> seen{header}, components;
  std::vector<std::string> open{header};
  while (!open.empty()) {
    std::ifstream in(root / open.back());
    open.pop_back();
    REQUIRE(in);
    for (std::string line; std::getline(in, line);) {
      if (line.rfind("#include <loopwise/", 0) != 0) continue;
      const std::string included = line.substr(10, line.find('>') - 10);
      if (seen.insert(included).second) open.push_back(included);
    }
  }
  for (const std::string& name : seen) components.insert(name.substr(9, name.find('/', 9) - 9));
  return components;
}

}  // namespace

TEST_CASE("module: its header needs neither files, networks, PCL nor bags", "[online][module]") {
  REQUIRE(components_behind("loopwise/online/loop_closure_module.hpp") ==
          std::set<std::string>{"core", "engine", "features", "generation", "linalg", "online",
                                "optimization", "prioritization", "registration"});
  // Files of graph networks are read behind the header.
  std::ifstream in(testing::fs::path(LOOPWISE_SOURCE_DIR) /
                   "include/loopwise/prioritization/graph_information.hpp");
  const std::string text((std::istreambuf_iterator<char>(in)), {});
  REQUIRE_THAT(text, !Contains("gnn.hpp") && !Contains("effect_network.hpp"));
}

}  // namespace loopwise::loop_closure_module_test
