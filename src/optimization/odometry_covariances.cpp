// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/odometry_covariances.hpp>

#include <algorithm>

#include "innovation.hpp"
#include "odometry_forest.hpp"

namespace loopwise {
namespace {

constexpr std::uint32_t kNone = UINT32_MAX;

bool is_odometry(const Edge& edge) {
  return edge.kind == EdgeKind::kOdometry;
}

}  // namespace

/// The other end of an edge, one step from a known place.
OdometryCovariances::Place OdometryCovariances::continued(const PoseGraph& graph, std::size_t edge,
                                                          std::uint32_t from) const {
  const Edge& step = graph.edges()[edge];
  const bool forward = graph.ends(edge).from == from;
  const Place& here = places_[from];
  Place next{here.root, from, here.depth + 1, here.pose, here.covariance, false};
  next.pose = se3::normalized(here.pose * (forward ? step.T_from_to : step.T_from_to.inverse()));
  // The error of the measurement is on the right of the pose of its `to` end.
  const Matrix6d ad = se3::adjoint(forward ? next.pose : here.pose);
  if (const auto own = detail::covariance_of(step.information)) {
    next.covariance += ad * *own * ad.transpose();
  } else {
    next.root = kNone;  // a step of unknown certainty does not join
  }
  return next;
}

void OdometryCovariances::update(const PoseGraph& graph) {
  if (!append(graph)) rebuild(graph);
}

/// Adds nodes that continue known chains. \returns false if the graph has changed otherwise
bool OdometryCovariances::append(const PoseGraph& graph) {
  const std::size_t known = places_.size();
  if (graph.nodes().size() < known || graph.priors().size() < priors_) return false;
  for (std::size_t node = known; node < graph.nodes().size(); ++node) {
    Place place;
    place.root = static_cast<std::uint32_t>(node);
    for (const std::size_t e : graph.edges_of(node)) {
      if (!is_odometry(graph.edges()[e])) continue;
      const auto [a, b] = graph.ends(e);
      const auto other = static_cast<std::uint32_t>(a == node ? b : a);
      if (other > node) continue;
      ++odometry_edges_;
      const Place next = continued(graph, e, other);
      if (next.root == kNone || (place.depth > 0 && place.parent == other)) continue;
      if (place.depth > 0) return false;  // joins two chains
      place = next;
    }
    places_.push_back(place);
  }
  const auto edges = std::count_if(graph.edges().begin(), graph.edges().end(), is_odometry);
  if (static_cast<std::size_t>(edges) != odometry_edges_) return false;
  for (; priors_ < graph.priors().size(); ++priors_) {
    const PriorFactor& prior = graph.priors()[priors_];
    const Place& root = places_[places_[graph.index_of(prior.key)].root];
    if (!root.anchored && detail::covariance_of(prior.information)) return false;
  }
  return true;
}

void OdometryCovariances::rebuild(const PoseGraph& graph) {
  places_.assign(graph.nodes().size(),
                 Place{kNone, kNone, 0, Eigen::Isometry3d::Identity(), Matrix6d::Zero(), false});
  std::vector<std::uint32_t> queue;
  const auto grow = [&](std::uint32_t root) {
    places_[root].root = root;
    queue.assign(1, root);
    for (std::size_t head = 0; head < queue.size(); ++head) {
      for (const std::size_t e : graph.edges_of(queue[head])) {
        const auto [a, b] = graph.ends(e);
        const auto next = static_cast<std::uint32_t>(a == queue[head] ? b : a);
        if (!is_odometry(graph.edges()[e]) || places_[next].root != kNone) continue;
        const Place place = continued(graph, e, queue[head]);
        if (place.root == kNone) continue;
        places_[next] = place;
        queue.push_back(next);
      }
    }
  };
  for (const PriorFactor& prior : graph.priors()) {
    const auto node = static_cast<std::uint32_t>(graph.index_of(prior.key));
    const auto own = detail::covariance_of(prior.information);
    if (places_[node].root != kNone || !own) continue;
    const Matrix6d ad = se3::adjoint(prior.pose);
    places_[node].pose = prior.pose;
    places_[node].covariance = ad * *own * ad.transpose();
    places_[node].anchored = true;
    grow(node);
  }
  for (std::uint32_t node = 0; node < places_.size(); ++node) {
    if (places_[node].root == kNone) grow(node);
  }
  priors_ = graph.priors().size();
  odometry_edges_ =
      static_cast<std::size_t>(std::count_if(graph.edges().begin(), graph.edges().end(), is_odometry));
}

std::optional<Matrix6d> OdometryCovariances::between(std::size_t from, std::size_t to) const {
  if (std::max(from, to) >= places_.size()) return std::nullopt;
  Matrix6d path = places_[from].covariance + places_[to].covariance;
  if (places_[from].root == places_[to].root) {
    auto a = static_cast<std::uint32_t>(from), b = static_cast<std::uint32_t>(to);
    while (a != b) {
      std::uint32_t& deeper = places_[a].depth > places_[b].depth ? a : b;
      deeper = places_[deeper].parent;
    }
    path -= 2.0 * places_[a].covariance;
  } else if (!places_[places_[from].root].anchored || !places_[places_[to].root].anchored) {
    return std::nullopt;
  }
  return detail::on_the_right(path, places_[to].pose);
}

}  // namespace loopwise
