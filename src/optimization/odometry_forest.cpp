// SPDX-License-Identifier: BSD-3-Clause
#include "odometry_forest.hpp"

#include <algorithm>

#include <Eigen/Dense>

#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>

namespace loopwise::detail {
namespace {

constexpr std::uint32_t kNone = UINT32_MAX;

}  // namespace

std::vector<char> known_inliers(const PoseGraph& graph) {
  std::vector<char> out(graph.edges().size());
  for (std::size_t e = 0; e < out.size(); ++e) out[e] = known_inlier(graph.edges()[e]) ? 1 : 0;
  return out;
}

std::optional<Matrix6d> covariance_of(const Matrix6d& information) {
  const Eigen::LDLT<Matrix6d> factor(information);
  const auto d = factor.vectorD();
  if (factor.info() != Eigen::Success || !(d.minCoeff() > 1e-12 * d.maxCoeff())) return std::nullopt;
  return Matrix6d(factor.solve(Matrix6d::Identity()));
}

OdometryForest::OdometryForest(const PoseGraph& graph) : OdometryForest(graph, known_inliers(graph)) {}

OdometryForest::OdometryForest(const PoseGraph& graph, const std::vector<char>& in_tree)
    : parent_(graph.nodes().size(), kNone),
      root_(graph.nodes().size(), kNone),
      depth_(graph.nodes().size(), 0),
      poses_(graph.poses()),
      covariance_(graph.nodes().size(), Matrix6d::Zero()),
      anchored_(graph.nodes().size(), 0) {
  for (const PriorFactor& prior : graph.priors()) {
    const auto node = static_cast<std::uint32_t>(graph.index_of(prior.key));
    const auto own = covariance_of(prior.information);
    if (root_[node] != kNone || !own) continue;
    poses_[node] = prior.pose;
    const Matrix6d ad = se3::adjoint(prior.pose);
    covariance_[node] = ad * *own * ad.transpose();
    anchored_[node] = 1;
    grow(graph, node, in_tree);
  }
  for (std::uint32_t node = 0; node < root_.size(); ++node) {
    if (root_[node] == kNone) grow(graph, node, in_tree);
  }
  index_ancestors();
}

void OdometryForest::grow(const PoseGraph& graph, std::uint32_t from, const std::vector<char>& in_tree) {
  std::vector<std::uint32_t> queue{from};
  root_[from] = from;
  for (std::size_t head = 0; head < queue.size(); ++head) {
    const std::uint32_t node = queue[head];
    for (const std::size_t e : graph.edges_of(node)) {
      const Edge& edge = graph.edges()[e];
      const auto ends = graph.ends(e);
      const bool forward = ends.from == node;
      const auto next = static_cast<std::uint32_t>(forward ? ends.to : ends.from);
      if (root_[next] != kNone || in_tree[e] == 0) continue;
      const auto step = covariance_of(edge.information);
      if (!step) continue;
      poses_[next] = se3::normalized(poses_[node] * (forward ? edge.T_from_to : edge.T_from_to.inverse()));
      // The error of the measurement is on the right of the pose of its `to` end.
      const Matrix6d ad = se3::adjoint(forward ? poses_[next] : poses_[node]);
      covariance_[next] = covariance_[node] + ad * *step * ad.transpose();
      parent_[next] = node;
      root_[next] = from;
      depth_[next] = depth_[node] + 1;
      queue.push_back(next);
    }
  }
}

void OdometryForest::index_ancestors() {
  const std::size_t n = parent_.size();
  std::vector<std::uint32_t> child(n, kNone), sibling(n, kNone), tour;
  for (std::size_t i = n; i-- > 0;) {
    if (parent_[i] == kNone) continue;
    sibling[i] = child[parent_[i]];
    child[parent_[i]] = static_cast<std::uint32_t>(i);
  }
  first_visit_.resize(n);
  const auto enter = [&](std::uint32_t node) {
    first_visit_[node] = static_cast<std::uint32_t>(tour.size());
    tour.push_back(node);
  };
  for (std::uint32_t root = 0; root < n; ++root) {
    if (parent_[root] != kNone) continue;
    enter(root);
    for (std::uint32_t node = root; node != kNone;) {
      const std::uint32_t next = child[node];
      if (next != kNone) {
        child[node] = sibling[next];
        enter(next);
        node = next;
      } else {
        node = parent_[node];
        if (node != kNone) tour.push_back(node);
      }
    }
  }
  highest_.push_back(std::move(tour));
  for (std::size_t width = 1; 2 * width <= highest_[0].size(); width *= 2) {
    const auto& last = highest_.back();
    std::vector<std::uint32_t> row(last.size() - width);
    for (std::size_t i = 0; i < row.size(); ++i) row[i] = higher(last[i], last[i + width]);
    highest_.push_back(std::move(row));
  }
}

std::uint32_t OdometryForest::common_ancestor(std::size_t a, std::size_t b) const {
  const auto [from, last] = std::minmax(first_visit_[a], first_visit_[b]);
  const std::size_t count = last - from + std::size_t{1};
  std::size_t level = 0;
  while ((std::size_t{2} << level) <= count) ++level;
  return higher(highest_[level][from], highest_[level][from + count - (std::size_t{1} << level)]);
}

std::optional<Matrix6d> OdometryForest::between(std::size_t a, std::size_t b) const {
  Matrix6d path = covariance_[a] + covariance_[b];
  if (root_[a] == root_[b]) return Matrix6d(path - 2.0 * covariance_[common_ancestor(a, b)]);
  if (anchored_[root_[a]] == 0 || anchored_[root_[b]] == 0) return std::nullopt;
  return path;
}

}  // namespace loopwise::detail
