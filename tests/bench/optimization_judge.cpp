// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_judge.hpp"

#include <time.h>

#include <algorithm>

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise::bench {

double thread_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

Verdict judge(const BenchGraph& graph, const std::function<bool(std::size_t)>& kept) {
  double found = 0, right = 0, all = 0;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
    if (known_inlier(graph.graph.edges()[e])) continue;
    all += graph.is_false[e] ? 1 : 0;
    if (kept(e)) continue;
    ++found;
    right += graph.is_false[e] ? 1 : 0;
  }
  return {all > 0 ? right / all : 1.0, found > 0 ? right / found : 1.0};
}

PoseGraph without_false(const BenchGraph& graph) {
  PoseGraph clean = graph.graph;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) clean.set_weight(e, graph.is_false[e] ? 0.0 : 1.0);
  return clean;
}

std::size_t closures_of(const PoseGraph& graph) {
  return static_cast<std::size_t>(
      std::count_if(graph.edges().begin(), graph.edges().end(),
                    [](const Edge& edge) { return edge.kind == EdgeKind::kLoopClosure; }));
}

double mean_distance(const std::vector<Eigen::Isometry3d>& a, const std::vector<Eigen::Isometry3d>& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += (a[i].translation() - b[i].translation()).norm();
  return sum / static_cast<double>(a.size());
}

double squared_residual(const PoseGraph& graph, std::size_t edge,
                        const std::vector<Eigen::Isometry3d>& poses) {
  const auto ends = graph.ends(edge);
  const Vector6d r = edge_residual(graph.edges()[edge], poses[ends.from], poses[ends.to]);
  return r.dot(graph.edges()[edge].information * r);
}

}  // namespace loopwise::bench
