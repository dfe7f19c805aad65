// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <iterator>

#include <loopwise/core/se3.hpp>

#include "engine_impl.hpp"

namespace loopwise {

void Engine::Impl::move(const std::optional<Placement::Move>& asked) {
  if (!asked) return;
  const auto& [group, anchor, pose] = *asked;
  // Also if no pose changes: the group is now fixed, which an estimate in progress does not know.
  moved_since_job_.insert(group.begin(), group.end());
  const Eigen::Isometry3d correction = pose * graph_.node(anchor).pose.inverse();
  if ((correction.matrix() - Eigen::Matrix4d::Identity()).cwiseAbs().maxCoeff() < 1e-9) return;
  forget_outcomes(group, correction);
  moved_.insert(moved_.end(), group.begin(), group.end());
  PoseGraph& graph = change_graph();
  for (const Key key : group) {
    graph.set_pose(key, key == anchor ? pose : se3::normalized(correction * graph.node(key).pose));
  }
  graph_is_new_ = may_choose_ = true;
  // Closures between the group and others now contradict its pose.
  if (std::any_of(group.begin(), group.end(), [this](Key key) { return closed_.count(key) != 0; }))
    wants_estimate_ = true;
}

void Engine::Impl::forget_outcomes(const std::vector<Key>& group, const Eigen::Isometry3d& correction) {
  constexpr double kSame_m = 0.01, kSame_rad = 0.002;  // changes below this do not matter to a registration
  const bool turns = se3::rotation_angle(correction) > kSame_rad;
  const std::unordered_set<Key> moving(group.begin(), group.end());
  const auto moved_relative = [&](const LoopCandidate& c) {
    const bool from = moving.count(c.from) != 0, to = moving.count(c.to) != 0;
    if (from == to) return false;
    const Eigen::Vector3d t = graph_.node(from ? c.from : c.to).pose.translation();
    return turns || (correction * t - t).norm() > kSame_m;
  };
  std::vector<LoopCandidate> forgotten;
  for (const Key key : group) {
    const auto found = revocable_rejections_.find(key);
    if (found == revocable_rejections_.end()) continue;
    std::copy_if(found->second.begin(), found->second.end(), std::back_inserter(forgotten), moved_relative);
  }
  for (const auto& [id, candidate] : in_computation_) {
    if (moved_relative(candidate)) moved_meanwhile_.insert(id);
  }
  for (const LoopCandidate& candidate : forgotten) {
    for (const Key end : {candidate.from, candidate.to}) {
      const auto at = revocable_rejections_.find(end);
      if (at == revocable_rejections_.end()) continue;
      std::vector<LoopCandidate>& kept = at->second;
      kept.erase(std::remove_if(kept.begin(), kept.end(),
                                [&](const LoopCandidate& c) { return c.id == candidate.id; }),
                 kept.end());
      if (kept.empty()) revocable_rejections_.erase(at);
    }
  }
  forgotten_.insert(forgotten_.end(), forgotten.begin(), forgotten.end());
}

void Engine::Impl::keep_rejected(const LoopCandidate& candidate, bool moved_meanwhile) {
  if (moved_meanwhile) {
    moved_.push_back(candidate.from);
    forgotten_.push_back(candidate);
  } else if (placement_.apart(candidate.from, candidate.to)) {
    for (const Key end : {candidate.from, candidate.to}) revocable_rejections_[end].push_back(candidate);
  }
}

void Engine::Impl::propose_moved() {
  std::vector<KeyPair> pairs;
  std::vector<LoopCandidate> again;
  for (LoopCandidate& candidate : forgotten_) {
    if (verdict_on(candidate.from, candidate.to) == Verdict::kRejected) continue;
    pairs.emplace_back(candidate.from, candidate.to);
    if (candidate.source == CandidateSource::kProximity) continue;
    candidate.distance_m =
        (graph_.node(candidate.from).pose.translation() - graph_.node(candidate.to).pose.translation())
            .norm();
    again.push_back(candidate);
  }
  forgotten_.clear();
  pool_.forget(pairs);
  propose(std::move(again));
  if (moved_.empty()) return;
  std::sort(moved_.begin(), moved_.end());
  moved_.erase(std::unique(moved_.begin(), moved_.end()), moved_.end());
  if (options_.use_proximity && prioritizes_) propose(generator_.on_moved(graph_, moved_, now_s_));
  moved_.clear();
}

}  // namespace loopwise
