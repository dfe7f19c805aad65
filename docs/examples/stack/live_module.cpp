// SPDX-License-Identifier: BSD-3-Clause
// How a SLAM stack runs Loopwise in parallel, in four ways: with all parts of Loopwise, and with its own back
// end, place recognition or prioritiser. Here a recorded mission replaces the front end; on a robot, key
// frames arrive during the drive, from any thread.
#include <algorithm>
#include <cstdio>
#include <deque>
#include <stdexcept>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/optimization/optimizer.hpp>

using namespace loopwise;

namespace {

/// The data of the front end about a new node.
KeyFrame key_frame(const Mission& mission, const Node& node) {
  KeyFrame frame;
  frame.node = node;
  for (const Edge& edge : mission.graph.edges()) {
    if (edge.kind != EdgeKind::kOdometry || edge.to != node.key) continue;
    frame.odometry.push_back({edge.from, edge.to, edge.T_from_to, edge.information});
  }
  for (const PriorFactor& prior : mission.graph.priors()) {
    if (prior.key == node.key) frame.priors.push_back(prior);
  }
  frame.cloud = mission.scans->load(node.key);
  return frame;
}

void drive(const Mission& mission, LoopClosureModule& module) {
  // Each add_* function returns false once the module has stopped.
  bool taken = true;
  for (const Node& node : mission.graph.nodes()) taken &= module.add_key_frame(key_frame(mission, node));
  for (const BeaconDrop& drop : mission.beacons) taken &= module.add_beacon_drop(drop);
  taken &= module.add_radio(mission.radio);
  if (!taken) throw std::runtime_error("the module has stopped");
}

void report(const char* what, const Mission& mission, const LoopClosureModule& module) {
  const PoseGraph graph = module.graph();
  const ModuleStatistics statistics = module.statistics();
  const double error =
      evaluate_trajectory(poses_by_key(graph), mission.ground_truth, Alignment::kNone, mission.robots)
          .ate_m.mean;
  std::printf("%-24s %5zu candidates, %5zu computed, mean error %.3f m\n", what,
              statistics.candidates.generated, statistics.candidates.computed, error);
}

/// Fewer candidates than on a robot, because this runs in a test.
ModuleOptions options(const char* method) {
  ModuleOptions options;
  options.prioritization.method = parse_method(method);
  options.engine.generation.radius_min_m = options.engine.generation.radius_max_m = 8.0;
  options.engine.generation.n_closest = 3;
  options.batch = 20;
  return options;
}

/// A robot does not wait: it reads estimate() or gets on_estimate.
void wait(LoopClosureModule& module) {
  if (!module.wait()) throw std::runtime_error("the module has stopped");
}

void all_parts_ours(const Mission& mission) {
  ModuleCallbacks callbacks;
  std::size_t closures = 0;
  callbacks.on_closure = [&](const LoopClosure&) { ++closures; };  // to a viewer, a log, another robot
  LoopClosureModule module(mission.robots, options("full"), callbacks);
  drive(mission, module);
  wait(module);
  report("all parts ours", mission, module);
  std::printf("%-24s %zu closures, %zu kept\n", "", closures,
              module.estimate() ? module.estimate()->inliers : 0);
}

void own_back_end(const Mission& mission) {
  ModuleOptions with_own = options("obs");
  with_own.engine.use_back_end = false;
  std::vector<LoopClosure> closures;  // input of the stack's own back end
  ModuleCallbacks callbacks;
  callbacks.on_closure = [&](const LoopClosure& closure) { closures.push_back(closure); };
  LoopClosureModule module(mission.robots, with_own, callbacks);
  drive(mission, module);
  wait(module);
  // The stack optimises in its own way, for example by GTSAM. It returns its poses, which generation and
  // prioritisation use.
  PoseGraph graph = mission.graph;
  for (const LoopClosure& closure : closures) graph.add_closure(closure);
  const OptimizationResult optimum = optimize(graph);
  ExternalEstimate estimate;
  for (std::size_t i = 0; i < graph.nodes().size(); ++i)
    estimate.poses[graph.nodes()[i].key] = optimum.poses[i];
  if (!module.set_estimate(estimate)) throw std::runtime_error("the module has stopped");
  wait(module);
  report("a back end of your own", mission, module);
}

void own_place_recognition(const Mission& mission) {
  ModuleOptions with_own = options("obs");
  with_own.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, with_own);
  drive(mission, module);
  // A real place recognition compares the scans. Here a few pairs of the two robots suffice, which left the
  // same gate.
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 0; i < 10; ++i) {
    LoopCandidate candidate;
    candidate.from = mission.robots[1].first + i;
    candidate.to = mission.robots[0].first + i;
    candidates.push_back(candidate);
  }
  if (!module.add_candidates(candidates)) throw std::runtime_error("the module has stopped");
  wait(module);
  report("your place recognition", mission, module);
}

/// The newest candidate first.
class NewestFirst final : public Prioritizer {
 public:
  [[nodiscard]] std::string_view name() const override { return "newest_first"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    held_.insert(held_.end(), candidates.begin(), candidates.end());
    return {};
  }
  void remove(const std::vector<CandidateId>& ids) override {
    const auto gone = [&](const LoopCandidate& c) {
      return std::find(ids.begin(), ids.end(), c.id) != ids.end();
    };
    held_.erase(std::remove_if(held_.begin(), held_.end(), gone), held_.end());
  }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override {
    std::vector<LoopCandidate> taken;
    for (; taken.size() < count && !held_.empty(); held_.pop_back()) taken.push_back(held_.back());
    return taken;
  }
  [[nodiscard]] std::size_t size() const override { return held_.size(); }

 private:
  std::deque<LoopCandidate> held_;
};

void own_prioritizer(const Mission& mission) {
  ModuleParts parts;
  parts.prioritizers.push_back(std::make_unique<NewestFirst>());
  LoopClosureModule module(mission.robots, options("full"), {}, std::move(parts));
  drive(mission, module);
  wait(module);
  report("a prioritiser of your own", mission, module);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: live_module MISSION\n");
    return 2;
  }
  try {
    const Mission mission = read_mission(argv[1]);
    if (mission.ground_truth.empty() || mission.robots.size() < 2) {
      throw InputError("the example needs a mission of two robots with ground truth");
    }
    all_parts_ours(mission);
    own_back_end(mission);
    own_place_recognition(mission);
    own_prioritizer(mission);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
