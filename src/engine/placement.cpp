// SPDX-License-Identifier: BSD-3-Clause
#include "placement.hpp"

#include <algorithm>

#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

bool Placement::is_full(const PriorFactor& prior) {
  // With a standard deviation of a full turn, a prior has no information on the rotation.
  constexpr double kLeastRotation = 0.025;  // 1 / (2 pi)^2, rad^-2
  using Solver = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>;
  const Eigen::Matrix3d translation = prior.information.topLeftCorner<3, 3>();
  const Eigen::Matrix3d rotation = prior.information.bottomRightCorner<3, 3>();
  return Solver(translation, Eigen::EigenvaluesOnly).eigenvalues()[0] > 0.0 &&
         Solver(rotation, Eigen::EigenvaluesOnly).eigenvalues()[0] > kLeastRotation;
}

std::optional<Placement::Step> Placement::step_to(const PoseGraph& graph, Key key, const Known& known) const {
  std::optional<Step> best;
  const bool landmark = robots_.is_landmark(key);
  for (const Edge* edge : known.edges) {
    if (edge->kind != (landmark ? EdgeKind::kLandmark : EdgeKind::kOdometry)) continue;
    const bool forward = edge->to == key;
    if (!forward && edge->from != key) continue;
    const auto other = graph.find(forward ? edge->from : edge->to);
    if (!other) continue;
    if (best) {
      const auto place = [&](std::size_t node) {
        return groups_.at(group_of_.at(graph.nodes()[node].key)).place;
      };
      if (place(*other) <= place(best->node)) continue;
    }
    best = Step{*other, forward ? edge->T_from_to : edge->T_from_to.inverse()};
  }
  return best;
}

Eigen::Isometry3d Placement::add(const PoseGraph& graph, const Node& node, const Known& known) {
  const bool first = begun_.count(robots_.of(node.key)) == 0;
  for (const PriorFactor* prior : known.priors) {
    if (prior->key != node.key || !is_full(*prior)) continue;
    join(node.key, std::nullopt, Place::kFixed);
    odometry_.push_back(prior->pose);
    return prior->pose;
  }
  if (const auto step = step_to(graph, node.key, known)) {
    const Eigen::Isometry3d odometry = odometry_[step->node] * step->T;
    const Eigen::Isometry3d pose = graph.nodes()[step->node].pose * step->T;
    if (!odometry.matrix().allFinite() || !pose.matrix().allFinite()) {
      throw InputError("odometry of node " + key_name(node.key) + ": the pose is not finite");
    }
    join(node.key, graph.nodes()[step->node].key, Place::kGiven);
    odometry_.push_back(se3::normalized(odometry));
    return se3::normalized(pose);
  }
  Eigen::Isometry3d pose = node.pose;
  if (first && !known.priors.empty() && known.priors.front()->key == node.key) {
    const PriorFactor& prior = *known.priors.front();
    if (prior.information.diagonal().head<3>().minCoeff() > 0.0) {
      pose.translation() = prior.pose.translation();
    }
  }
  join(node.key, std::nullopt, first ? Place::kFirst : Place::kGiven);
  odometry_.push_back(pose);
  return pose;
}

void Placement::join(Key key, std::optional<Key> member, Place place) {
  begun_.insert(robots_.of(key));
  const std::size_t number = member ? group_of_.at(*member) : next_++;
  Group& group = groups_[number];
  if (!member) group.place = place;
  group.nodes.push_back(key);
  group_of_[key] = number;
}

std::optional<Placement::Move> Placement::tie(const PoseGraph& graph, const Edge& edge) {
  std::size_t a = group_of_.at(edge.from), b = group_of_.at(edge.to);
  if (a == b) return std::nullopt;
  const auto rank = [this](std::size_t group) {
    return std::pair(groups_.at(group).place, groups_.at(group).nodes.size());
  };
  const bool second_moves = rank(b) <= rank(a);
  if (!second_moves) std::swap(a, b);  // b moves to a
  std::optional<Move> move;
  if (groups_.at(b).place != Place::kFixed) {
    const Key stays = second_moves ? edge.from : edge.to;
    const Eigen::Isometry3d T = second_moves ? edge.T_from_to : edge.T_from_to.inverse();
    move = Move{groups_.at(b).nodes, second_moves ? edge.to : edge.from,
                se3::normalized(graph.node(stays).pose * T)};
    move_odometry(graph, *move, se3::normalized(odometry_[graph.index_of(stays)] * T));
  }
  const Place place = groups_.at(a).place;
  if (groups_.at(a).nodes.size() < groups_.at(b).nodes.size())
    std::swap(a, b);  // the smaller group is renamed
  Group& into = groups_.at(a);
  for (const Key key : groups_.at(b).nodes) group_of_[key] = a;
  into.nodes.insert(into.nodes.end(), groups_.at(b).nodes.begin(), groups_.at(b).nodes.end());
  into.place = place;
  groups_.erase(b);
  return move;
}

std::optional<Placement::Move> Placement::settle(const PoseGraph& graph, const PriorFactor& prior) {
  Group& group = groups_.at(group_of_.at(prior.key));
  if (!is_full(prior) || group.place == Place::kFixed) return std::nullopt;
  group.place = Place::kFixed;
  const Move move{group.nodes, prior.key, prior.pose};
  move_odometry(graph, move, prior.pose);
  return move;
}

bool Placement::apart(Key first, Key second) const {
  const std::size_t a = group_of_.at(first), b = group_of_.at(second);
  return a != b && (groups_.at(a).place != Place::kFixed || groups_.at(b).place != Place::kFixed);
}

void Placement::move_odometry(const PoseGraph& graph, const Move& move, const Eigen::Isometry3d& pose) {
  const std::size_t anchor = graph.index_of(move.anchor);
  const Eigen::Isometry3d correction = pose * odometry_[anchor].inverse();
  for (const Key key : move.group) {
    Eigen::Isometry3d& at = odometry_[graph.index_of(key)];
    at = key == move.anchor ? pose : se3::normalized(correction * at);
  }
}

}  // namespace loopwise
