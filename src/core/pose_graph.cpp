// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/pose_graph.hpp>

#include <cmath>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>

namespace loopwise {
namespace {

std::string describe(Key key) {
  const std::string name = key_name(key), number = std::to_string(key);
  return name == number ? number : number + " (" + name + ")";
}

std::string name_of(const PriorFactor& prior) {
  return "prior of " + describe(prior.key);
}

std::string name_of(const Edge& edge) {
  return "edge " + describe(edge.from) + " to " + describe(edge.to);
}

bool is_rigid(const Eigen::Isometry3d& pose) {
  return pose.matrix().allFinite() && se3::rotation_defect(pose.linear()) <= 1e-6;
}

/// The weight 1/sigma² must be finite as well.
void require_sigma(double sigma, const std::string& what) {
  if (!(sigma >= 1e-12 && sigma <= 1e12))
    throw InputError(what + ": sigma " + std::to_string(sigma) + " is not positive");
}

/// The information matrix that the graph stores. In a planar graph, fixed values replace those of z, roll and
/// pitch, so that zeros there do not make a matrix singular.
Matrix6d kept_information(const Matrix6d& stated, bool planar) {
  return planar ? planar::information(planar::block(stated)) : stated;
}

[[noreturn]] void refuse_gravity(Key key) {
  throw InputError("gravity at " + describe(key) +
                   ": gravity does not observe yaw, so a planar graph cannot use it");
}

/// Reserves space for one more value and at least doubles the capacity. Throws if memory is missing; the
/// push_back() that follows cannot throw then.
template <class Value>
void make_room(std::vector<Value>& values) {
  if (values.size() == values.capacity()) values.reserve(2 * values.size() + 1);
}

}  // namespace

void PoseGraph::require_pose(const Eigen::Isometry3d& pose, const std::string& what) const {
  if (!pose.matrix().allFinite()) throw InputError(what + ": pose is not finite");
  if (!is_rigid(pose)) throw InputError(what + ": pose is not a rigid transform");
  if (planar_ && !planar::is_pose(pose))
    throw InputError(what + ": pose has z, roll or pitch, but the graph is planar");
}

bool PoseGraph::fits(const Eigen::Isometry3d& pose) const {
  return is_rigid(pose) && (!planar_ || planar::is_pose(pose));
}

void PoseGraph::require_information(const Matrix6d& information, const std::string& what) const {
  const auto require_sound = [&](const Matrix6d& m) {
    if (const char* why = check_information(m)) throw InputError(what + ": information is " + why);
  };
  require_sound(information);
  if (!planar_) return;
  if (!planar::is_information(information)) {
    throw InputError(what +
                     ": information couples z, roll or pitch with x, y or yaw, but the graph is planar");
  }
  // The stored values are checked as well: large stated values of z, roll or pitch would hide errors in the
  // rest.
  require_sound(kept_information(information, true));
}

const char* check_information(const Matrix6d& information) {
  if (!information.allFinite()) return "not finite";
  const double scale = information.cwiseAbs().maxCoeff();
  if ((information - information.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale) return "not symmetric";
  if (scale == 0.0) return nullptr;
  // Scaled to a unit diagonal, because values for metres and for radians differ by orders of magnitude.
  const Vector6d diagonal = information.diagonal();
  if (diagonal.minCoeff() < 0.0) return "indefinite";
  Vector6d d;
  for (int i = 0; i < 6; ++i)
    d[i] = diagonal[i] > 0.0 ? 1.0 / std::sqrt(diagonal[i]) : 1.0 / std::sqrt(scale);
  const Matrix6d scaled = d.asDiagonal() * information * d.asDiagonal();
  if (!scaled.allFinite()) return "indefinite";  // an element is far too large for the diagonal
  if (Eigen::LLT<Matrix6d>(scaled).info() == Eigen::Success) return nullptr;
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(scaled, Eigen::EigenvaluesOnly);
  return solver.eigenvalues().minCoeff() < -1e-9 * scaled.cwiseAbs().maxCoeff() ? "indefinite" : nullptr;
}

void PoseGraph::set_planar(bool planar) {
  const bool was_planar = std::exchange(planar_, planar);
  if (!planar || was_planar) return;
  try {
    for (const Node& node : nodes_) require_pose(node.pose, "node " + describe(node.key));
    for (const PriorFactor& prior : priors_) {
      require_pose(prior.pose, name_of(prior));
      require_information(prior.information, name_of(prior));
    }
    for (const Edge& edge : edges_) {
      require_pose(edge.T_from_to, name_of(edge));
      require_information(edge.information, name_of(edge));
    }
    if (!gravities_.empty()) refuse_gravity(gravities_.front().key);
  } catch (...) {
    planar_ = false;
    throw;
  }
  for (PriorFactor& prior : priors_) prior.information = kept_information(prior.information, true);
  for (Edge& edge : edges_) edge.information = kept_information(edge.information, true);
}

std::size_t PoseGraph::add_node(const Node& node) {
  require_pose(node.pose, "node " + describe(node.key));
  make_room(nodes_);
  make_room(adjacency_);
  if (!index_.emplace(node.key, nodes_.size()).second) {
    throw InputError("node " + describe(node.key) + " is in the graph already");
  }
  nodes_.push_back(node);
  adjacency_.emplace_back();
  return nodes_.size() - 1;
}

std::size_t PoseGraph::add_prior(const PriorFactor& prior) {
  static_cast<void>(index_of(prior.key));
  require_pose(prior.pose, name_of(prior));
  require_information(prior.information, name_of(prior));
  priors_.push_back(prior);
  priors_.back().information = kept_information(prior.information, planar_);
  return priors_.size() - 1;
}

std::size_t PoseGraph::add_edge(const Edge& edge) {
  const Ends ends{index_of(edge.from), index_of(edge.to)};
  const std::string what = name_of(edge);
  if (ends.from == ends.to) throw InputError(what + ": both ends are the same node");
  require_pose(edge.T_from_to, what);
  require_information(edge.information, what);
  if (!(edge.weight >= 0.0 && edge.weight <= 1.0)) throw InputError(what + ": weight is outside [0, 1]");
  const std::size_t number = edges_.size();
  make_room(edges_);
  make_room(ends_);
  make_room(adjacency_[ends.from]);
  make_room(adjacency_[ends.to]);
  edges_.push_back(edge);
  edges_.back().information = kept_information(edge.information, planar_);
  ends_.push_back(ends);
  adjacency_[ends.from].push_back(number);
  adjacency_[ends.to].push_back(number);
  return number;
}

std::size_t PoseGraph::add_range(const RangeFactor& range) {
  const std::string what = "range " + describe(range.from) + " to " + describe(range.to);
  if (index_of(range.from) == index_of(range.to)) throw InputError(what + ": both ends are the same node");
  if (!(range.range_m >= 0.0) || !std::isfinite(range.range_m)) {
    throw InputError(what + ": " + std::to_string(range.range_m) +
                     " m is not a valid distance, must be >= 0");
  }
  require_sigma(range.sigma_m, what);
  ranges_.push_back(range);
  return ranges_.size() - 1;
}

std::size_t PoseGraph::add_gravity(const GravityFactor& gravity) {
  static_cast<void>(index_of(gravity.key));
  const std::string what = "gravity at " + describe(gravity.key);
  if (planar_) refuse_gravity(gravity.key);
  GravityFactor unit = gravity;
  for (Eigen::Vector3d* direction : {&unit.direction, &unit.reference}) {
    const double length = direction->norm();
    if (!std::isfinite(length) || !(length > 0.0)) throw InputError(what + ": direction has no length");
    *direction /= length;
  }
  require_sigma(gravity.sigma_rad, what);
  gravities_.push_back(unit);
  return gravities_.size() - 1;
}

std::size_t PoseGraph::add_closure(const LoopClosure& closure) {
  Edge edge;
  edge.from = closure.from;
  edge.to = closure.to;
  edge.T_from_to = closure.T_from_to;
  const Eigen::LLT<Matrix6d> factor(closure.covariance);
  if (!closure.covariance.allFinite() || factor.info() != Eigen::Success) {
    throw InputError("closure " + describe(closure.from) + " to " + describe(closure.to) +
                     ": covariance is not positive definite");
  }
  const Matrix6d information = factor.solve(Matrix6d::Identity());
  edge.information = 0.5 * (information + information.transpose());
  edge.kind = EdgeKind::kLoopClosure;
  return add_edge(edge);
}

std::size_t PoseGraph::replace_edges(std::vector<Edge> edges) {
  const std::size_t removed = edges_.size() - edges.size();
  if (removed == 0) return 0;
  std::vector<Ends> ends;
  ends.reserve(edges.size());
  std::vector<std::vector<std::size_t>> adjacency(nodes_.size());
  for (std::size_t i = 0; i < edges.size(); ++i) {
    ends.push_back({index_of(edges[i].from), index_of(edges[i].to)});
    adjacency[ends[i].from].push_back(i);
    adjacency[ends[i].to].push_back(i);
  }
  edges_ = std::move(edges);
  ends_ = std::move(ends);
  adjacency_ = std::move(adjacency);
  return removed;
}

std::optional<std::size_t> PoseGraph::find(Key key) const {
  const auto found = index_.find(key);
  return found == index_.end() ? std::nullopt : std::optional<std::size_t>(found->second);
}

std::size_t PoseGraph::index_of(Key key) const {
  if (const auto number = find(key)) return *number;
  throw UnknownKeyError("node " + describe(key) + " is not in the graph");
}

std::vector<Key> PoseGraph::keys() const {
  std::vector<Key> keys;
  keys.reserve(nodes_.size());
  for (const Node& node : nodes_) keys.push_back(node.key);
  return keys;
}

void PoseGraph::set_pose(Key key, const Eigen::Isometry3d& pose) {
  if (!fits(pose)) require_pose(pose, "node " + describe(key));
  nodes_[index_of(key)].pose = pose;
}

void PoseGraph::set_poses(const std::vector<Eigen::Isometry3d>& poses) {
  if (poses.size() != nodes_.size()) {
    throw InputError(std::to_string(poses.size()) + " poses for " + std::to_string(nodes_.size()) + " nodes");
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (!fits(poses[i])) require_pose(poses[i], "node " + describe(nodes_[i].key));
  }
  for (std::size_t i = 0; i < poses.size(); ++i) nodes_[i].pose = poses[i];
}

std::vector<Eigen::Isometry3d> PoseGraph::poses() const {
  std::vector<Eigen::Isometry3d> poses;
  poses.reserve(nodes_.size());
  for (const Node& node : nodes_) poses.push_back(node.pose);
  return poses;
}

void PoseGraph::refuse_number(const char* what, std::size_t number, std::size_t count) {
  const std::string name(what);
  throw InputError(name + " number " + std::to_string(number) + " is not in the graph, which has " +
                   std::to_string(count) + " " + name + (count == 1 ? "" : "s") + ", numbered from 0");
}

Edge& PoseGraph::edge_at(std::size_t number) {
  if (number >= edges_.size()) refuse_number("edge", number, edges_.size());
  return edges_[number];
}

void PoseGraph::set_covariance(std::size_t node, const std::optional<Matrix6d>& covariance) {
  if (node >= nodes_.size()) refuse_number("node", node, nodes_.size());
  if (covariance && !covariance->allFinite()) {
    throw InputError("node " + describe(nodes_[node].key) + ": covariance is not finite");
  }
  nodes_[node].covariance = covariance;
}

void PoseGraph::set_weight(std::size_t edge, double weight) {
  Edge& changed = edge_at(edge);
  if (!(weight >= 0.0 && weight <= 1.0)) throw InputError(name_of(changed) + ": weight is outside [0, 1]");
  changed.weight = weight;
}

void PoseGraph::set_trusted(std::size_t edge, bool trusted) {
  edge_at(edge).trusted = trusted;
}

void PoseGraph::set_kind(std::size_t edge, EdgeKind kind) {
  edge_at(edge).kind = kind;
}

void PoseGraph::set_information(std::size_t edge, const Matrix6d& information) {
  Edge& changed = edge_at(edge);
  require_information(information, name_of(changed));
  changed.information = kept_information(information, planar_);
}

std::vector<std::size_t> connected_components(const PoseGraph& graph) {
  DisjointSets joined(graph.nodes().size());
  for (std::size_t e = 0; e < graph.edges().size(); ++e) joined.join(graph.ends(e).from, graph.ends(e).to);
  std::vector<std::size_t> component(graph.nodes().size());
  std::size_t count = 0;
  for (std::size_t i = 0; i < component.size(); ++i) {
    const std::size_t r = joined.root(i);
    component[i] = r == i ? count++ : component[r];
  }
  return component;
}

}  // namespace loopwise
