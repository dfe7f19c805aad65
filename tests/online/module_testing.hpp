// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What the tests of the module share.
#pragma once

#include <algorithm>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/prioritization/baselines.hpp>

#include "replay/testing_mission.hpp"

namespace loopwise::testing {

[[nodiscard]] inline ModuleOptions module_options(const std::string& method = "random") {
  ModuleOptions options;
  options.prioritization.method = parse_method(method);
  options.prioritization.observability.min_sum = 0.0;
  options.batch = 20;
  options.threads = 2;
  return options;
}

/// Each node as a front end would hand it over.
[[nodiscard]] inline std::vector<KeyFrame> key_frames(const Mission& mission) {
  std::vector<KeyFrame> frames;
  for (const Node& node : mission.graph.nodes()) {
    KeyFrame frame;
    frame.node = node;
    for (const Edge& edge : mission.graph.edges()) {
      if (edge.to == node.key && edge.kind == EdgeKind::kOdometry) frame.odometry.push_back(between(edge));
    }
    for (const PriorFactor& prior : mission.graph.priors()) {
      if (prior.key == node.key) frame.priors.push_back(prior);
    }
    frame.cloud = mission.scans->load(node.key);
    frames.push_back(frame);
  }
  std::sort(frames.begin(), frames.end(),
            [](const KeyFrame& a, const KeyFrame& b) { return a.node.stamp_ns < b.node.stamp_ns; });
  return frames;
}

[[nodiscard]] inline ModuleParts with_oracle(const Mission& mission) {
  ModuleParts parts;
  parts.registrar = given(std::make_shared<OracleRegistrar>(mission.ground_truth));
  return parts;
}

/// Reports its calls to functions of the test, and fails if they throw.
class CallbackPrioritizer final : public Prioritizer {
 public:
  struct Callbacks {
    std::function<void(Key)> scan = [](Key) {};
    std::function<void()> graph = [] {}, take = [] {};
  };
  explicit CallbackPrioritizer(Callbacks calls) : callbacks_(std::move(calls)) {}
  [[nodiscard]] std::string_view name() const override { return "callback"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    return arrival_.add(candidates);
  }
  void remove(const std::vector<CandidateId>& ids) override { arrival_.remove(ids); }
  void on_scan(const KeyedScan& scan) override { callbacks_.scan(scan.key); }
  void on_graph(const PoseGraph&) override { callbacks_.graph(); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override {
    callbacks_.take();
    return arrival_.take(count);
  }
  [[nodiscard]] std::size_t size() const override { return arrival_.size(); }

 private:
  const Callbacks callbacks_;
  ArrivalPrioritizer arrival_;
};

}  // namespace loopwise::testing
