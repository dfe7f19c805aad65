// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_gtsam.hpp"

#include <cstdio>

#ifdef LOOPWISE_HAS_GTSAM

#include <algorithm>
#include <array>
#include <exception>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <gtsam/config.h>
#include <gtsam/geometry/Pose3.h>
#include <gtsam/nonlinear/GncOptimizer.h>
#include <gtsam/nonlinear/LevenbergMarquardtOptimizer.h>
#include <gtsam/nonlinear/Marginals.h>
#include <gtsam/nonlinear/PriorFactor.h>
#include <gtsam/slam/BetweenFactor.h>

#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "optimization_graphs.hpp"
#include "optimization_judge.hpp"

namespace loopwise::bench {
namespace {

/// A graph in GTSAM's types, built outside of the measured times. Slots: the edges in their order, then the
/// priors.
struct GtsamProblem {
  gtsam::NonlinearFactorGraph factors;
  gtsam::Values values;

  explicit GtsamProblem(const PoseGraph& graph) {
    const auto noise = [](const Matrix6d& information) {
      return gtsam::noiseModel::Gaussian::Information(se3::swap_tangent_order(information));
    };
    for (const Node& node : graph.nodes()) values.insert(node.key, gtsam::Pose3(node.pose.matrix()));
    for (const Edge& edge : graph.edges()) {
      factors.emplace_shared<gtsam::BetweenFactor<gtsam::Pose3>>(
          edge.from, edge.to, gtsam::Pose3(edge.T_from_to.matrix()), noise(edge.information));
    }
    for (const PriorFactor& prior : graph.priors()) {
      factors.addPrior(prior.key, gtsam::Pose3(prior.pose.matrix()), noise(prior.information));
    }
  }
};

std::vector<Eigen::Isometry3d> poses_of(const PoseGraph& graph, const gtsam::Values& values) {
  std::vector<Eigen::Isometry3d> poses;
  for (const Node& node : graph.nodes()) poses.emplace_back(values.at<gtsam::Pose3>(node.key).matrix());
  return poses;
}

/// ½ Σ rᵀΩr by our own residuals, so that both results are judged alike.
double cost_at(const PoseGraph& graph, const std::vector<Eigen::Isometry3d>& poses) {
  double cost = 0.0;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) cost += 0.5 * squared_residual(graph, e, poses);
  for (const PriorFactor& prior : graph.priors()) {
    const Vector6d r = se3::log(prior.pose.inverse() * poses[graph.index_of(prior.key)]);
    cost += 0.5 * r.dot(prior.information * r);
  }
  return cost;
}

/// Median processor time of some rounds, ms; works that take long run once. The works are done in turns.
template <std::size_t N>
std::array<double, N> times_in_turns(const std::array<std::function<void()>, N>& works) {
  constexpr int kRounds = 5;
  std::array<std::vector<double>, N> all;
  for (int round = 0; round < kRounds; ++round) {
    for (std::size_t k = 0; k < N; ++k) {
      if (!all[k].empty() && all[k].front() > 5e3) continue;
      const double start = thread_seconds();
      works[k]();
      all[k].push_back(1e3 * (thread_seconds() - start));
    }
  }
  std::array<double, N> medians{};
  for (std::size_t k = 0; k < N; ++k) {
    std::sort(all[k].begin(), all[k].end());
    medians[k] = all[k][all[k].size() / 2];
  }
  return medians;
}

void show_plain(const BenchGraph& graph) {
  const GtsamProblem problem(graph.graph);
  OptimizationResult ours;
  gtsam::Values theirs;
  double our_trace = 0.0, their_trace = 0.0;
  const auto ms = times_in_turns<4>(
      {[&] { ours = optimize(graph.graph); },
       [&] { theirs = gtsam::LevenbergMarquardtOptimizer(problem.factors, problem.values).optimize(); },
       [&] {
         PoseGraph optimum = graph.graph;
         optimum.set_poses(ours.poses);
         our_trace = marginals(optimum).trace_full;
       },
       [&] {
         const gtsam::Marginals covariances(problem.factors, theirs);
         their_trace = 0.0;
         for (const Node& node : graph.graph.nodes()) {
           their_trace += covariances.marginalCovariance(node.key).trace();
         }
       }});
  std::printf("| %s | %.2f | %.1f | %.1f | %.9g | %.9g | %.2f | %.1f | %.1f | %.6g | %.6g |\n",
              graph.name.c_str(), ms[0], ms[1], ms[1] / ms[0], cost_at(graph.graph, ours.poses),
              cost_at(graph.graph, poses_of(graph.graph, theirs)), ms[2], ms[3], ms[3] / ms[2], our_trace,
              their_trace);
  std::fflush(stdout);
}

void show_robust(const BenchGraph& graph) {
  const GtsamProblem problem(graph.graph);
  gtsam::GncParams<gtsam::LevenbergMarquardtParams> parameters;
  gtsam::GncParams<gtsam::LevenbergMarquardtParams>::IndexVector known;
  const auto& edges = graph.graph.edges();
  for (std::size_t e = 0; e < edges.size(); ++e) {
    if (known_inlier(edges[e])) known.push_back(e);
  }
  for (std::size_t p = 0; p < graph.graph.priors().size(); ++p) known.push_back(edges.size() + p);
  parameters.setKnownInliers(known);
  GncResult ours;
  gtsam::Values theirs;
  gtsam::Vector weights;
  const auto ms =
      times_in_turns<2>({[&] { ours = optimize_gnc(graph.graph); },
                         [&] {
                           using Optimizer =
                               gtsam::GncOptimizer<gtsam::GncParams<gtsam::LevenbergMarquardtParams>>;
                           Optimizer optimizer(problem.factors, problem.values, parameters);
                           theirs = optimizer.optimize();
                           weights = optimizer.getWeights();
                         }});
  const auto clean = optimize(without_false(graph)).poses;
  const Verdict of_ours = judge(graph, [&](std::size_t e) { return ours.weights[e] > 0.5; });
  const Verdict of_theirs =
      judge(graph, [&](std::size_t e) { return weights[static_cast<Eigen::Index>(e)] > 0.5; });
  std::printf("| %s | %.1f | %.0f | %.0f | %.3f | %.3f | %.2g | %.3f | %.3f | %.2g |\n", graph.name.c_str(),
              ms[0], ms[1], ms[1] / ms[0], of_ours.recall, of_ours.precision,
              mean_distance(ours.optimization.poses, clean), of_theirs.recall, of_theirs.precision,
              mean_distance(poses_of(graph.graph, theirs), clean));
  std::fflush(stdout);
}

std::vector<BenchGraph> graphs_of(const std::string& folder, const std::string& filter, bool labelled) {
  std::vector<BenchGraph> out;
  for (const auto& path : g2o_files(folder)) {
    if (path.string().find(filter) == std::string::npos) continue;
    BenchGraph graph = read_bench_graph(path);
    const bool has_false =
        std::find(graph.is_false.begin(), graph.is_false.end(), true) != graph.is_false.end();
    if (has_false == labelled) out.push_back(std::move(graph));
  }
  return out;
}

}  // namespace

bool compare_gtsam(const std::string& folder, const std::string& filter) {
  std::printf("GTSAM %s\n", GTSAM_VERSION_STRING);
  const std::vector<BenchGraph> plain = graphs_of(folder, filter, false);
  const std::vector<BenchGraph> robust = graphs_of(folder, filter, true);
  if (!plain.empty()) {
    std::printf(
        "\n| file | optimise, ms | GTSAM LM, ms | ratio | cost | GTSAM's | marginals, ms | GTSAM's, ms | "
        "ratio | "
        "trace | GTSAM's |\n| --- |%s\n",
        " --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
  }
  const auto show = [](const BenchGraph& graph, void (*row)(const BenchGraph&)) {
    try {
      row(graph);
    } catch (const std::exception& error) {
      std::printf("| %s | %s |\n", graph.name.c_str(), error.what());
    }
  };
  for (const BenchGraph& graph : plain) show(graph, show_plain);
  if (!robust.empty()) {
    std::printf(
        "\n| file | GNC, ms | GTSAM GNC, ms | ratio | recall | precision | ATE, m | GTSAM's recall | "
        "precision | "
        "ATE, m |\n| --- |%s\n",
        " --- | --- | --- | --- | --- | --- | --- | --- | --- |");
  }
  for (const BenchGraph& graph : robust) show(graph, show_robust);
  return true;
}

}  // namespace loopwise::bench

#else

namespace loopwise::bench {

bool compare_gtsam(const std::string&, const std::string&) {
  std::fprintf(stderr, "this build has no GTSAM: configure with -DGTSAM_DIR=PREFIX/lib/cmake/GTSAM\n");
  return false;
}

}  // namespace loopwise::bench

#endif
