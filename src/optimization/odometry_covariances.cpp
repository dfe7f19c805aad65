// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/odometry_covariances.hpp>

#include "innovation.hpp"
#include "odometry_forest.hpp"

namespace loopwise {

std::vector<std::optional<Matrix6d>> odometry_covariances(const PoseGraph& graph,
                                                          const std::vector<LoopCandidate>& candidates) {
  const detail::OdometryForest forest(graph);
  std::vector<std::optional<Matrix6d>> out;
  out.reserve(candidates.size());
  for (const LoopCandidate& candidate : candidates) {
    out.emplace_back();
    if (!graph.contains(candidate.from) || !graph.contains(candidate.to)) continue;
    const std::size_t to = graph.index_of(candidate.to);
    if (const auto between = forest.between(graph.index_of(candidate.from), to)) {
      out.back() = detail::on_the_right(*between, forest.pose(to));
    }
  }
  return out;
}

}  // namespace loopwise
