// SPDX-License-Identifier: BSD-3-Clause
// two_robots MISSION: the live module beside two front ends; a recorded mission replaces them here.
#include <algorithm>
#include <cstdio>
#include <map>
#include <mutex>
#include <vector>

#include <loopwise/io/mission.hpp>
#include <loopwise/online/loop_closure_module.hpp>

int main(int argc, char** argv) {
  using namespace loopwise;
  if (argc != 2) return 2;
  const Mission mission = read_mission(argv[1]);
  const PoseGraph& recorded = mission.graph;

  std::mutex mutex;  // callbacks come from a thread of the module
  std::map<Key, Eigen::Isometry3d> corrected;
  ModuleCallbacks callbacks;
  callbacks.on_estimate = [&](const std::shared_ptr<const Estimate>& estimate) {
    const std::lock_guard<std::mutex> lock(mutex);
    for (const Node& node : estimate->graph.nodes()) corrected[node.key] = node.pose;
  };
  ModuleOptions options;
  options.engine.generation.radius_min_m = options.engine.generation.radius_max_m = 8.0;
  LoopClosureModule module(mission.robots, options, callbacks);  // knows both robots from the start

  for (const Node& node : recorded.nodes()) {  // in a stack: from any thread, whenever a robot sends a node
    KeyFrame frame;
    frame.node = node;
    for (const Edge& e : recorded.edges()) {
      if (e.to == node.key && e.kind == EdgeKind::kOdometry)
        frame.odometry.push_back({e.from, e.to, e.T_from_to, e.information});
    }
    for (const PriorFactor& prior : recorded.priors()) {  // the robot's start in the common frame
      if (prior.key == node.key) frame.priors.push_back(prior);
    }
    frame.cloud = mission.scans->load(node.key);
    if (!module.add_key_frame(frame)) return 1;  // the module was stopped
  }
  if (!module.wait()) return 1;  // a robot does not need to wait

  const PoseGraph graph = module.graph();  // all nodes, factors and closures, at the last estimate
  std::size_t closures = 0, kept = 0;
  for (const Edge& edge : graph.edges()) {
    if (edge.kind != EdgeKind::kLoopClosure) continue;
    ++closures;
    if (edge.weight > 0.5) ++kept;
  }
  std::printf("%zu of %zu nodes corrected, %zu of %zu closures kept\n", corrected.size(),
              graph.nodes().size(), kept, closures);
  return kept > 0 && !corrected.empty() ? 0 : 1;
}
