// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Verdicts on robust optimisation of graphs whose false closures are known.
#pragma once

#include <functional>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "optimization_graphs.hpp"

namespace loopwise::bench {

/// Processor time of the calling thread, s.
[[nodiscard]] double thread_seconds();

/// Of false closures found and of those found to be false.
struct Verdict {
  double recall = 1.0;     ///< Share of the false closures that were excluded.
  double precision = 1.0;  ///< Share of the excluded closures that are false.
};

/// Judges the closures (edges that are not known inliers) by a predicate on the number of the edge.
[[nodiscard]] Verdict judge(const BenchGraph& graph, const std::function<bool(std::size_t)>& kept);

/// The graph with weight 0 on the false closures and 1 on the other edges.
[[nodiscard]] PoseGraph without_false(const BenchGraph& graph);

/// Number of edges of kind loop closure.
[[nodiscard]] std::size_t closures_of(const PoseGraph& graph);

/// Mean distance between the translations of two lists of poses.
[[nodiscard]] double mean_distance(const std::vector<Eigen::Isometry3d>& a,
                                   const std::vector<Eigen::Isometry3d>& b);

/// rᵀΩr of an edge at these poses.
[[nodiscard]] double squared_residual(const PoseGraph& graph, std::size_t edge,
                                      const std::vector<Eigen::Isometry3d>& poses);

}  // namespace loopwise::bench
