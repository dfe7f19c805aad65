// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/odometry_walk.hpp>

namespace loopwise {

std::optional<OdometryWalk::Place> OdometryWalk::next() {
  if (!at_) return std::nullopt;
  const Place here_place = *at_;
  const Key here = graph_.nodes()[here_place.node].key;
  const std::optional<std::size_t> robot = robots_.find(here);
  at_.reset();
  for (const std::size_t number : graph_.edges_of(here_place.node)) {
    const Edge& edge = graph_.edges()[number];
    if (edge.kind != EdgeKind::kOdometry) continue;
    const PoseGraph::Ends ends = graph_.ends(number);
    const bool outgoing = ends.from == here_place.node;
    const std::size_t other = outgoing ? ends.to : ends.from;
    const Key there = graph_.nodes()[other].key;
    if ((there > here) != forward_ || robots_.find(there) != robot) continue;
    if (at_) {
      const Key known = graph_.nodes()[at_->node].key;
      if (forward_ ? known <= there : known >= there) continue;
    }
    at_ = Place{other, number,
                here_place.T_start_here * (outgoing ? edge.T_from_to : edge.T_from_to.inverse())};
  }
  return at_;
}

}  // namespace loopwise
