// SPDX-License-Identifier: BSD-3-Clause
// How a SLAM stack links Loopwise stage by stage and keeps its own parts. Here a recorded mission replaces
// the front end, which on a robot delivers one key frame after the other.
#include <cstdio>

#include <loopwise/core/error.hpp>
#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/prioritization/observability.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/task.hpp>

using namespace loopwise;

namespace {

class BaseStation {
 public:
  BaseStation(const Robots& robots, const ScanLoader& scans)
      : robots_(robots),
        features_(std::make_shared<FeatureCache>(scans)),
        registrar_(features_),
        generator_(proximity_preset("lamp_base"), robots),
        pool_(CandidatePoolOptions(), prioritizers()) {}

  /// A robot's next node, with the odometry edge and the prior that lead to it, and its scan.
  void add_key_frame(Node node, const std::vector<Edge>& odometry, const std::vector<PriorFactor>& priors,
                     const KeyedScan& scan, double time_s) {
    // Odometry continues from the optimised estimate.
    if (!odometry.empty()) node.pose = graph_.node(odometry[0].from).pose * odometry[0].T_from_to;
    graph_.add_node(node);
    for (const Edge& edge : odometry) graph_.add_edge(edge);
    for (const PriorFactor& prior : priors) graph_.add_prior(prior);
    pool_.add(generator_.on_node(graph_, node.key, time_s));  // or candidates of your own place recognition
    if (scan.cloud) pool_.on_scan(scan);
  }

  /// Computes the `count` most promising candidates, and optimises if that closed a loop.
  void close_loops(std::size_t count, ThreadPool& threads) {
    std::vector<RegistrationTask> tasks;
    for (const LoopCandidate& candidate : pool_.take(count)) {
      tasks.push_back(make_task(graph_, robots_, candidate, TaskOptions(), /*seed=*/1));
    }
    bool closed = false;
    for (const auto& result : compute_batch(registrar_, tasks, threads)) {
      pool_.complete(*result);
      if (!result->verified()) continue;  // result->reason and result->message say why
      graph_.add_closure(*result->closure);
      closed = true;
    }
    if (!closed) return;
    const GncResult estimate = optimizer_.optimize_gnc(graph_, GncOptions());  // or a back end of your own
    graph_.set_poses(estimate.optimization.poses);
    for (std::size_t i = 0; i < estimate.weights.size(); ++i) graph_.set_weight(i, estimate.weights[i]);
    generator_.on_graph(graph_);
    pool_.on_graph(graph_);
    inliers_ = estimate.inliers;
  }

  [[nodiscard]] const PoseGraph& graph() const { return graph_; }
  [[nodiscard]] const CandidateAccounting& accounting() const { return pool_.accounting(); }
  [[nodiscard]] std::size_t inliers() const { return inliers_; }

 private:
  RoundRobinQueue prioritizers() {
    std::vector<std::unique_ptr<Prioritizer>> list;  // several alternate; add your own
    list.push_back(std::make_unique<ObservabilityPrioritizer>(
        ObservabilityPriorityOptions(), robots_, [features = features_](const KeyedScan& scan) {
          const auto of_scan = features->get(scan.key);
          return of_scan ? of_scan->observability.min_eigenvalue : 0.0;
        }));
    return RoundRobinQueue(std::move(list));
  }

  Robots robots_;
  std::shared_ptr<FeatureCache> features_;
  FastRegistrar registrar_;
  ProximityGenerator generator_;
  CandidatePool pool_;
  PoseGraphOptimizer optimizer_;
  PoseGraph graph_;
  std::size_t inliers_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: link_stages MISSION\n");
    return 2;
  }
  try {
    const Mission mission = read_mission(argv[1]);
    BaseStation station(mission.robots, mission.scans->loader());
    ThreadPool threads;
    std::size_t frames = 0;
    for (const Node& node : mission.graph.nodes()) {
      std::vector<Edge> odometry;
      for (const Edge& edge : mission.graph.edges()) {
        if (edge.kind == EdgeKind::kOdometry && edge.to == node.key) odometry.push_back(edge);
      }
      std::vector<PriorFactor> priors;
      for (const PriorFactor& prior : mission.graph.priors()) {
        if (prior.key == node.key) priors.push_back(prior);
      }
      station.add_key_frame(node, odometry, priors, {node.key, node.stamp_ns, mission.scans->load(node.key)},
                            mission.time_s(node.stamp_ns));
      if (++frames % 10 == 0) station.close_loops(5, threads);
    }
    std::printf("%zu candidates, %zu computed, %zu closures kept\n", station.accounting().generated,
                station.accounting().computed, station.inliers());
    if (!mission.ground_truth.empty()) {
      const auto error = [&](const PoseGraph& graph) {
        return evaluate_trajectory(poses_by_key(graph), mission.ground_truth, Alignment::kNone,
                                   mission.robots)
            .ate_m.mean;
      };
      std::printf("mean error %.2f m by odometry, %.2f m now\n", error(mission.graph),
                  error(station.graph()));
    }
    return 0;
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
