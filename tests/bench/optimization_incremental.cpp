// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_incremental.hpp"

#include <algorithm>
#include <cstdio>
#include <numeric>
#include <string>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/incremental.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "optimization_graphs.hpp"
#include "optimization_judge.hpp"

namespace loopwise::bench {
namespace {

constexpr std::size_t kBatch = 50;
constexpr std::size_t kBatches = 20;

double furthest_apart(const PoseGraph& a, const std::vector<Eigen::Isometry3d>& b) {
  double most = 0.0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    most = std::max(most, (a.nodes()[i].pose.translation() - b[i].translation()).norm());
  }
  return most;
}

/// What is left for the batches, and the graph without it.
struct Split {
  PoseGraph start;
  std::vector<Node> nodes;
  std::vector<Edge> edges;
};

/// Leaves out randomly chosen closures.
Split without_closures(const PoseGraph& graph, std::uint64_t seed) {
  Split out;
  for (const Node& node : graph.nodes()) out.start.add_node(node);
  for (const PriorFactor& prior : graph.priors()) out.start.add_prior(prior);
  Rng rng(seed);
  std::vector<char> left(graph.edges().size(), 0);
  const auto closures = static_cast<std::size_t>(
      std::count_if(graph.edges().begin(), graph.edges().end(),
                    [](const Edge& edge) { return edge.kind != EdgeKind::kOdometry; }));
  while (out.edges.size() < std::min(closures / 2, kBatch * kBatches)) {
    const std::size_t k = rng.below(graph.edges().size());
    if (left[k] != 0 || graph.edges()[k].kind == EdgeKind::kOdometry) continue;
    left[k] = 1;
    out.edges.push_back(graph.edges()[k]);
  }
  for (std::size_t k = 0; k < left.size(); ++k) {
    if (left[k] == 0) out.start.add_edge(graph.edges()[k]);
  }
  return out;
}

/// Leaves out the last nodes, in the order of the graph, and all that ends at them.
Split without_last_nodes(const PoseGraph& graph, std::size_t count) {
  Split out;
  for (const Node& node : graph.nodes()) {
    if (graph.index_of(node.key) + count < graph.nodes().size()) {
      out.start.add_node(node);
    } else {
      out.nodes.push_back(node);
    }
  }
  for (const PriorFactor& prior : graph.priors()) {
    if (out.start.contains(prior.key)) out.start.add_prior(prior);
  }
  for (const Edge& edge : graph.edges()) {
    if (out.start.contains(edge.from) && out.start.contains(edge.to)) {
      out.start.add_edge(edge);
    } else {
      out.edges.push_back(edge);
    }
  }
  return out;
}

void show(const std::string& name, Split split) {
  IncrementalOptimizer incremental(split.start);
  std::vector<double> seconds;
  std::size_t iterations = 0, moved = 0, relinearized = 0, updates = 0, from_scratch = 0, reordered = 0;
  std::vector<char> added(split.edges.size(), 0);
  const auto add_ready = [&](std::size_t most) {
    std::size_t count = 0;
    for (std::size_t k = 0; k < split.edges.size() && count < most; ++k) {
      const Edge& edge = split.edges[k];
      if (added[k] != 0 || !incremental.graph().contains(edge.from) || !incremental.graph().contains(edge.to))
        continue;
      incremental.add_edge(edge);
      added[k] = 1;
      ++count;
    }
    return count;
  };
  double full_seconds = 0.0;
  OptimizationResult full;
  for (std::size_t batch = 0; batch < kBatches; ++batch) {
    const std::size_t begin = split.nodes.size() * batch / kBatches;
    const std::size_t end = split.nodes.size() * (batch + 1) / kBatches;
    for (std::size_t i = begin; i < end; ++i) {
      Node node = split.nodes[i];
      // From the present pose of the node before it, by odometry.
      for (const Edge& edge : split.edges) {
        if (edge.to == node.key && edge.kind == EdgeKind::kOdometry)
          node.pose = se3::normalized(incremental.graph().node(edge.from).pose * edge.T_from_to);
      }
      incremental.add_node(node);
    }
    add_ready(split.nodes.empty() ? kBatch : split.edges.size());
    const bool last = batch + 1 == kBatches;
    if (last) {
      const double begin_full = thread_seconds();
      OptimizerOptions options;
      options.initialization = Initialization::kFile;
      full = optimize(incremental.graph(), options);
      full_seconds = thread_seconds() - begin_full;
    }
    const double begin_update = thread_seconds();
    const IncrementalResult result = incremental.update();
    seconds.push_back(thread_seconds() - begin_update);
    ++updates;
    iterations += static_cast<std::size_t>(result.iterations);
    moved += result.moved;
    relinearized += result.relinearized;
    from_scratch += result.from_scratch ? 1 : 0;
    reordered += result.reordered ? 1 : 0;
    if (last) {
      std::vector<double> sorted = seconds;
      std::sort(sorted.begin(), sorted.end());
      const auto mean = [&](std::size_t sum) {
        return static_cast<double>(sum) / static_cast<double>(updates);
      };
      std::printf("%-34s %9.2f %9.2f %9.1f %6.1f %8.0f %8.0f %4zu %4zu %9.2e %9.1e\n", name.c_str(),
                  1e3 * sorted[sorted.size() / 2], 1e3 * sorted.back(), 1e3 * full_seconds, mean(iterations),
                  mean(moved), mean(relinearized), reordered, from_scratch,
                  furthest_apart(incremental.graph(), full.poses), result.cost / full.cost - 1.0);
      std::fflush(stdout);
    }
  }
}

}  // namespace

void compare_batches(std::size_t poses, std::uint64_t seed) {
  std::printf("%-34s %9s %9s %9s %6s %8s %8s %4s %4s %9s %9s\n", "50 closures a batch, 20 batches",
              "median ms", "most ms", "full ms", "steps", "moved", "relin.", "ord.", "full", "apart m",
              "cost");
  const BenchGraph graph = streets(poses, 2 * poses, std::max<std::size_t>(2, poses / 5000), seed);
  show(graph.name + " between", without_closures(graph.graph, seed + 1));
  show(graph.name + " new poses", without_last_nodes(graph.graph, 25 * kBatches));
}

}  // namespace loopwise::bench
