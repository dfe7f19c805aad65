// SPDX-License-Identifier: BSD-3-Clause
// own_registrar MISSION: a registration of your own in the live module.
#include <atomic>
#include <cstdio>
#include <memory>

#include <loopwise/io/mission.hpp>
#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/registration/align.hpp>

using namespace loopwise;

/// Any function that aligns two clouds, here align(). Called from several threads at once.
class MyRegistrar final : public Registrar {
 public:
  explicit MyRegistrar(ScanLoader scans) : scans_(std::move(scans)) {}

  [[nodiscard]] std::string_view name() const override { return "mine"; }

  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    RegistrationResult result;
    result.candidate = task.candidate;
    const Key from = task.candidate.from, to = task.candidate.to;
    const auto source = scans_(to), target = scans_(from);  // null: the node has no scan
    if (!source || !target) {
      result.reason = RejectionReason::kMissingScan;
      return result;
    }
    AlignOptions options;
    options.guess = task.guess_from_to;
    const AlignResult aligned = align(*target, *source, options);
    result.reason = aligned.reason;
    result.message = aligned.message;
    result.overlap = aligned.inlier_share;
    // T_from_to maps points of `to` to the frame of `from`; its covariance has the order [translation,
    // rotation].
    if (aligned.success) result.closure = LoopClosure{from, to, aligned.T_target_source, aligned.covariance};
    return result;
  }

 private:
  ScanLoader scans_;
};

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const Mission mission = read_mission(argv[1]);
  ModuleParts parts;
  parts.registrar = [](const ScanLoader& scans) { return std::make_shared<MyRegistrar>(scans); };
  std::atomic<int> closures{0};
  ModuleCallbacks callbacks;
  callbacks.on_closure = [&](const LoopClosure&) { ++closures; };
  ModuleOptions options;
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 0; i < 6; ++i) {  // the two robots have left the same gate
    for (const Robot& robot : mission.robots.all()) {
      KeyFrame frame;
      frame.node = mission.graph.node(robot.first + i);
      frame.cloud = mission.scans->load(frame.node.key);
      if (!module.add_key_frame(frame)) return 1;
    }
    candidates.emplace_back();
    candidates.back().from = mission.robots[1].first + i;
    candidates.back().to = mission.robots[0].first + i;
  }
  if (!module.add_candidates(candidates) || !module.wait()) return 1;
  std::printf("%d closures\n", closures.load());
  return closures > 0 ? 0 : 1;
}
