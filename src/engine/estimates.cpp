// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "engine_impl.hpp"

namespace loopwise {

bool fits(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  constexpr double kSame = 1e-6;  // m and rad
  return se3::log(a.inverse() * b).cwiseAbs().maxCoeff() < kSame;
}

bool fits(const PriorFactor& prior, const Eigen::Isometry3d& pose) {
  constexpr double kNegligible = 1e-9;
  const Vector6d r = se3::log(prior.pose.inverse() * pose);
  return r.dot(prior.information * r) < kNegligible || fits(prior.pose, pose);
}

void Engine::Impl::on(event::Settle& settle) {
  if (!computing_) start_estimate(settle.last);
}

void Engine::Impl::start_estimate(bool last) {
  if (last && options_.use_back_end && (estimate_continues_ || optimizing_)) {
    wants_estimate_ = last_wanted_ = true;
  }
  if (!wants_estimate_ || !options_.use_back_end || optimizing_) return;
  wants_estimate_ = removed_since_job_ = false;
  moved_since_job_.clear();
  optimizing_ = true;
  const auto now = snapshot();
  emit(effect::Optimize{std::shared_ptr<const PoseGraph>(now, &now->graph),
                        std::exchange(last_wanted_, false)});
}

void Engine::Impl::on(event::Optimized& event) {
  if (!optimizing_) throw InputError("an estimate that was not requested");
  optimizing_ = false;
  if (!event.failure.empty()) problem("the back end failed", event.failure);
  const bool nothing = event.stopped || !event.failure.empty();
  // The estimate used edges that were removed since then; the next estimate is already requested.
  if (nothing || removed_since_job_) return;
  estimate_continues_ = !event.gnc.fresh;
  const std::vector<Eigen::Isometry3d>& poses = event.gnc.optimization.poses;
  PoseGraph& graph = change_graph();
  for (std::size_t e = 0; e < event.gnc.weights.size(); ++e) graph.set_weight(e, event.gnc.weights[e]);
  if (moved_since_job_.empty() && poses.size() == graph.nodes().size()) {
    graph.set_poses(poses);
  } else {
    std::unordered_map<Key, Eigen::Isometry3d> named;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      // A node that odometry or a prior moved meanwhile moves with the nodes that it was joined to.
      const Key key = graph.nodes()[i].key;
      if (moved_since_job_.count(key) == 0) named.emplace(key, poses[i]);
    }
    move_nodes(named);
    if (contradicts_new_factors(poses, event.gnc.weights.size())) wants_estimate_ = true;
  }
  publish();
}

bool Engine::Impl::contradicts_new_factors(const std::vector<Eigen::Isometry3d>& estimated,
                                           std::size_t edges_estimated) const {
  if (moved_since_job_.empty()) return false;
  const auto placed = [this](Key key) { return moved_since_job_.count(key) != 0; };
  // Odometry alone only repeats the former pose of its group.
  for (std::size_t e = 0; e < edges_estimated; ++e) {
    const Edge& edge = graph_.edges()[e];
    if (edge.kind == EdgeKind::kOdometry) continue;
    for (const Key end : {edge.from, edge.to}) {
      if (placed(end) && !fits(graph_.node(end).pose, estimated[graph_.index_of(end)])) return true;
    }
  }
  const bool edges_fit = std::all_of(graph_.edges().begin(), graph_.edges().end(), [&](const Edge& edge) {
    if (edge.kind != EdgeKind::kOdometry || placed(edge.from) == placed(edge.to)) return true;
    return fits(graph_.node(edge.from).pose * edge.T_from_to, graph_.node(edge.to).pose);
  });
  return !edges_fit ||
         std::any_of(graph_.priors().begin(), graph_.priors().end(), [&](const PriorFactor& prior) {
           return Placement::is_full(prior) && placed(prior.key) &&
                  !fits(prior.pose, graph_.node(prior.key).pose);
         });
}

void Engine::Impl::on(ExternalEstimate& estimate) {
  if (options_.use_back_end)
    throw InputError("an external estimate needs the option engine.use_back_end to be off");
  std::unordered_map<Key, Eigen::Isometry3d> named;
  for (const auto& [key, pose] : estimate.poses) {
    if (!graph_.contains(key)) continue;
    const bool rounded = se3::rotation_defect(pose.linear()) > 1e-9;
    named.emplace(key, rounded ? se3::normalized(pose) : pose);
  }
  move_nodes(named);
  for (const auto& [key, pose] : named) placement_.fix(key);
  for (const auto& [key, covariance] : estimate.covariances) {
    if (const auto node = graph_.find(key)) change_graph().set_covariance(*node, covariance);
  }
  publish();
}

void Engine::Impl::move_nodes(const std::unordered_map<Key, Eigen::Isometry3d>& named) {
  std::vector<std::pair<std::size_t, std::size_t>> order;  // robot, node
  order.reserve(graph_.nodes().size());
  for (std::size_t i = 0; i < graph_.nodes().size(); ++i)
    order.emplace_back(robots_.of(graph_.nodes()[i].key), i);
  std::sort(order.begin(), order.end(), [this](const auto& a, const auto& b) {
    return std::pair(a.first, graph_.nodes()[a.second].key) <
           std::pair(b.first, graph_.nodes()[b.second].key);
  });
  std::vector<Eigen::Isometry3d> poses = graph_.poses();
  Eigen::Isometry3d correction = Eigen::Isometry3d::Identity();
  for (std::size_t k = 0; k < order.size(); ++k) {
    const auto [robot, i] = order[k];
    if (k == 0 || order[k - 1].first != robot) correction.setIdentity();
    if (const auto found = named.find(graph_.nodes()[i].key); found != named.end()) {
      correction = found->second * poses[i].inverse();
      poses[i] = found->second;
    } else {
      poses[i] = se3::normalized(correction * poses[i]);
    }
  }
  change_graph().set_poses(poses);
}

void Engine::Impl::publish() {
  auto estimate = std::make_shared<Estimate>();
  estimate->graph = graph_;
  estimate->revision = ++revision_;
  estimate->continued = estimate_continues_;
  for (const Edge& edge : graph_.edges()) {
    if (edge.kind != EdgeKind::kLoopClosure) continue;
    ++estimate->closures;
    if (edge.weight > 0.5) ++estimate->inliers;
  }
  snapshot_ = estimate;
  generator_.on_graph(graph_);
  graph_is_new_ = may_choose_ = true;
  announce_graph();
  emit(effect::EstimateReady{std::move(estimate)});
}

}  // namespace loopwise
