// SPDX-License-Identifier: BSD-3-Clause
// A user-defined prioritiser and its effect: the same number of candidates is computed in its order and in
// the order of arrival.
#include <cstdio>

#include <loopwise/core/error.hpp>
#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/prioritization/ranked_candidates.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/task.hpp>

using namespace loopwise;

/// The longest loop first, because drift grows with the path between two nodes. Between two robots, this path
/// leads through their common start.
class LongestLoopFirst final : public Prioritizer {
 public:
  explicit LongestLoopFirst(Robots robots) : robots_(std::move(robots)) {}

  [[nodiscard]] std::string_view name() const override { return "longest_loop"; }

  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    for (const LoopCandidate& candidate : candidates) {
      const auto from = static_cast<double>(robots_.node_index(candidate.from));
      const auto to = static_cast<double>(robots_.node_index(candidate.to));
      const bool one_robot = robots_.of(candidate.from) == robots_.of(candidate.to);
      ranked_.insert(candidate, one_robot ? std::abs(from - to) : from + to);
    }
    return {};  // refuses none; {id, "reason"} would be counted as pruned
  }
  void remove(const std::vector<CandidateId>& ids) override { ranked_.erase(ids); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return ranked_.take(count); }
  [[nodiscard]] std::size_t size() const override { return ranked_.size(); }
  // on_graph(), on_scan(), on_result() and improve() are optional and give more information.

 private:
  Robots robots_;
  RankedCandidates ranked_;  // by falling score, equal scores by age
};

/// Mean error of all positions once `count` candidates were computed in the order of a prioritiser, m.
double error_after(std::size_t count, std::unique_ptr<Prioritizer> prioritizer, const Mission& mission) {
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  prioritizers.push_back(std::move(prioritizer));
  CandidatePool pool(CandidatePoolOptions(), RoundRobinQueue(std::move(prioritizers)));
  ProximityGenerator generator(proximity_preset("lamp_base"), mission.robots);
  PoseGraph graph = mission.graph;
  for (const Node& node : graph.nodes()) {
    pool.on_scan({node.key, node.stamp_ns, mission.scans->load(node.key)});
    pool.add(generator.on_node(graph, node.key, mission.time_s(node.stamp_ns)));
  }

  std::vector<RegistrationTask> tasks;
  for (const LoopCandidate& candidate : pool.take(count)) {
    tasks.push_back(make_task(graph, mission.robots, candidate, TaskOptions(), /*seed=*/1));
  }
  const FastRegistrar registrar(std::make_shared<FeatureCache>(mission.scans->loader()));
  ThreadPool threads;
  for (const auto& result : compute_batch(registrar, tasks, threads)) {
    pool.complete(*result);
    if (result->verified()) graph.add_closure(*result->closure);
  }
  graph.set_poses(optimize_gnc(graph).optimization.poses);
  return evaluate_trajectory(poses_by_key(graph), mission.ground_truth, Alignment::kNone, mission.robots)
      .ate_m.mean;
}

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: own_prioritizer MISSION\n");
    return 2;
  }
  try {
    const Mission mission = read_mission(argv[1]);
    const double arrival = error_after(60, std::make_unique<ArrivalPrioritizer>(), mission);
    const double own = error_after(60, std::make_unique<LongestLoopFirst>(mission.robots), mission);
    std::printf("mean error after 60 registrations: %.3f m in order of arrival, %.3f m longest loop first\n",
                arrival, own);
    return own < arrival ? 0 : 1;
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
