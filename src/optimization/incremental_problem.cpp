// SPDX-License-Identifier: BSD-3-Clause
#include "incremental_problem.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <loopwise/optimization/auxiliary_factors.hpp>

namespace loopwise::detail {
namespace {

/// Cost of a new order of elimination for each factor, in operations of a factorisation: analysis and
/// linearisation.
constexpr double kOrderFlopsPerFactor = 1.5e4;
/// Unless a complete factorisation takes this many times the operations of when the order was new, an update
/// that costs much is an exception.
constexpr double kDenser = 1.2;
/// Shares of a graph that may be added at once without a new order.
constexpr double kMostNewNodes = 0.1;
constexpr double kMostNewFactors = 0.1;
/// Added to the diagonal of the Hessian at a held node, so that no step moves it.
constexpr double kHeldInformation = 1e30;

Pose inverse_of(const Pose& pose) {
  return {pose.R.transpose(), -(pose.R.transpose() * pose.t)};
}

Pose pose_of(const Node& node) {
  Pose out;
  out.R = Eigen::Quaterniond(node.pose.linear()).normalized().toRotationMatrix();
  out.t = node.pose.translation();
  return out;
}

/// Square of the change of a relative pose: of the angle in rad or the share of its length (at least 1 m),
/// whichever is larger.
double squared_change(const Pose& before, const Pose& now) {
  const double angle2 = 0.5 * (before.R - now.R).squaredNorm();  // (2 sin(θ/2))²
  return std::max(angle2, (before.t - now.t).squaredNorm() / std::max(1.0, before.t.squaredNorm()));
}

/// A range depends only on T_to⁻¹ T_from.
LinearizedRange linearize_range(const RangeFactor& range, const Pose& e) {
  return linearize(range, isometry(e), Eigen::Isometry3d::Identity());
}

}  // namespace

void NumberSet::sort() {
  if (numbers_.size() < in_.size() / 16) {
    std::sort(numbers_.begin(), numbers_.end());
    return;
  }
  numbers_.clear();
  for (std::uint32_t i = 0; i < in_.size(); ++i) {
    if (in_[i] != 0) numbers_.push_back(i);
  }
}

std::uint32_t IncrementalProblem::add_factor(Kind kind, std::size_t index, std::uint32_t from,
                                             std::uint32_t to) {
  const auto k = static_cast<std::uint32_t>(factors_.size());
  factors_.push_back({kind, static_cast<std::uint32_t>(index), from, to});
  active_.push_back(0);
  crosses_.emplace_back(Matrix6d::Zero());
  drift_.push_back(0.0);
  changed_.grow(factors_.size());
  factors_of_[to].push_back(k);
  if (from != kFixed) factors_of_[from].push_back(k);
  return k;
}

/// Adds the nodes and factors that `graph` has gained since the last call.
void IncrementalProblem::register_additions() {
  for (std::size_t i = poses.size(); i < graph.nodes().size(); ++i) {
    poses.push_back(pose_of(graph.nodes()[i]));
    factors_of_.emplace_back();
    gradients_.emplace_back(Vector6d::Zero());
    diagonals_.emplace_back(Matrix6d::Zero());
  }
  open_.grow(poses.size());
  while (edge_factor_.size() < graph.edges().size()) register_edge(edge_factor_.size());
  for (; known_priors_ < graph.priors().size(); ++known_priors_) {
    const std::uint32_t node = number(graph.priors()[known_priors_].key);
    waiting_.push_back(add_factor(Kind::kPrior, known_priors_, kFixed, node));
  }
  for (; known_ranges_ < graph.ranges().size(); ++known_ranges_) {
    const RangeFactor& range = graph.ranges()[known_ranges_];
    waiting_.push_back(add_factor(Kind::kRange, known_ranges_, number(range.from), number(range.to)));
  }
  for (; known_gravities_ < graph.gravities().size(); ++known_gravities_) {
    const std::uint32_t node = number(graph.gravities()[known_gravities_].key);
    waiting_.push_back(add_factor(Kind::kGravity, known_gravities_, kFixed, node));
  }
  for (const std::size_t edge : reweighted_) waiting_.push_back(edge_factor_[edge]);
  reweighted_.clear();
}

void IncrementalProblem::register_edge(std::size_t edge) {
  const PoseGraph::Ends ends = graph.ends(edge);
  edge_factor_.push_back(add_factor(Kind::kEdge, edge, static_cast<std::uint32_t>(ends.from),
                                    static_cast<std::uint32_t>(ends.to)));
  waiting_.push_back(edge_factor_.back());
}

/// T_to⁻¹ T_from, which determines residual and derivatives; for gravity the pose of its node.
Pose IncrementalProblem::relative_pose(const Factor& f) const {
  if (f.kind == Kind::kGravity) return poses[f.to];
  return f.from == kFixed ? inverse_of(poses[f.to]) : between(poses[f.to], poses[f.from]);
}

IncrementalProblem::Measurement IncrementalProblem::measurement(const Factor& f) const {
  if (f.kind == Kind::kEdge) {
    const Edge& edge = graph.edges()[f.index];
    return {edge.T_from_to, edge.information};
  }
  const PriorFactor& prior = graph.priors()[f.index];
  return {prior.pose, prior.information};
}

/// Blocks of the Hessian of a factor at a relative pose.
Contribution IncrementalProblem::contribution(const Factor& f, const Pose& e) const {
  Contribution out;
  if (f.kind == Kind::kRange) {
    const LinearizedRange l = linearize_range(graph.ranges()[f.index], e);
    out.to_to = l.J_to.transpose() * l.J_to;
    out.to_from = l.J_to.transpose() * l.J_from;
    out.from_from = l.J_from.transpose() * l.J_from;
  } else if (f.kind == Kind::kGravity) {
    const LinearizedGravity l = linearize(graph.gravities()[f.index], isometry(e));
    out.to_to = l.J.transpose() * l.J;
  } else {
    const Measurement m = measurement(f);
    const Vector6d r = log_of_product(inverse(m.Z), inverse_of(e));
    linearize_factor(r, e, m.information, f.weight, f.from != kFixed, out);
  }
  return out;
}

/// Gradient and cost of a factor at a relative pose.
void IncrementalProblem::evaluate(const Factor& f, const Pose& e, FactorGradient& gradient,
                                  double& cost) const {
  if (f.kind == Kind::kRange) {
    const LinearizedRange l = linearize_range(graph.ranges()[f.index], e);
    gradient = {l.J_to.transpose() * l.r, l.J_from.transpose() * l.r};
    cost = 0.5 * l.r * l.r;
  } else if (f.kind == Kind::kGravity) {
    const LinearizedGravity l = linearize(graph.gravities()[f.index], isometry(e));
    gradient.to = l.J.transpose() * l.r;
    cost = 0.5 * l.r.squaredNorm();
  } else {
    const Measurement m = measurement(f);
    const Vector6d r = log_of_product(inverse(m.Z), inverse_of(e));
    gradient = factor_gradient(r, e, m.information, f.weight);
    cost = 0.5 * f.weight * r.dot(m.information * r);
  }
}

/// Adds a factor's gradient and cost to the sums.
void IncrementalProblem::add_to_sums(const Factor& f) {
  gradients_[f.to] += f.gradient.to;
  if (f.from != kFixed) gradients_[f.from] += f.gradient.from;
  cost_ += f.cost;
}

void IncrementalProblem::sum_gradient(std::uint32_t node) {
  gradients_[node].setZero();
  for (const std::uint32_t k : factors_of_[node]) {
    const Factor& f = factors_[k];
    if (active_[k] != 0) gradients_[node] += f.to == node ? f.gradient.to : f.gradient.from;
  }
}

void IncrementalProblem::sum_cost() {
  cost_ = 0.0;
  for (std::size_t k = 0; k < factors_.size(); ++k) {
    if (active_[k] != 0) cost_ += factors_[k].cost;
  }
}

/// Adds a factor's part to the Hessian (sign 1) or removes it (−1).
void IncrementalProblem::add_to_hessian(std::uint32_t k, double sign) {
  const Factor& f = factors_[k];
  const Contribution c = contribution(f, f.linear);
  diagonals_[f.to] += sign * c.to_to;
  cholesky_.touch(f.to);
  if (f.from == kFixed) return;
  diagonals_[f.from] += sign * c.from_from;
  crosses_[k] = c.to_from;
  cholesky_.touch(f.from);
}

void IncrementalProblem::linearize_here(std::uint32_t k) {
  factors_[k].linear = relative_pose(factors_[k]);
  drift_[k] = 0.0;
  add_to_hessian(k, 1.0);
}

void IncrementalProblem::activate(std::uint32_t k) {
  Factor& f = factors_[k];
  active_[k] = 1;
  evaluate(f, relative_pose(f), f.gradient, f.cost);
  add_to_sums(f);
  linearize_here(k);
  reopen(f);
}

void IncrementalProblem::deactivate(std::uint32_t k) {
  if (active_[k] == 0) return;
  const Factor& f = factors_[k];
  add_to_hessian(k, -1.0);
  active_[k] = 0;
  // Summed again instead of subtracted: the rounding error of a false closure's gradient may exceed the other
  // gradients.
  sum_gradient(f.to);
  if (f.from != kFixed) sum_gradient(f.from);
  reopen(f);
}

void IncrementalProblem::reopen(const Factor& f) {
  open_.insert(f.to);
  if (f.from != kFixed) open_.insert(f.from);
}

bool IncrementalProblem::absorb() {
  register_additions();
  if (reorder_is_due()) {
    reorder();
    return true;
  }
  flops_of_last_ = 0.0;
  // If this is interrupted, the Cholesky factor cannot be used.
  sound_ = false;
  const auto first = static_cast<std::uint32_t>(absorbed_nodes_);
  for (; absorbed_nodes_ < poses.size(); ++absorbed_nodes_) {
    cholesky_.append();
    components_.add();
    has_prior_.push_back(0);
    held_at_.push_back(kFixed);
    held_.push_back(0);
  }
  for (const std::uint32_t k : waiting_) apply_factor(k);
  waiting_.clear();
  sum_cost();
  if (edge_removed_) {
    find_components();
  } else {
    hold_components(first);
  }
  sound_ = true;
  return false;
}

/// While additions make the factor denser, updates take longer and longer. Their mean cost, with that of the
/// order, is lowest if a new order is computed once an update costs more than the mean.
bool IncrementalProblem::reorder_is_due() const {
  const std::size_t new_nodes = poses.size() - absorbed_nodes_;
  const bool costly = flops_of_last_ * static_cast<double>(updates_) > flops_of_updates_;
  return !sound_ || (costly && cholesky_.flops() > kDenser * flops_when_ordered_) ||
         static_cast<double>(new_nodes) > kMostNewNodes * static_cast<double>(absorbed_nodes_) ||
         static_cast<double>(waiting_.size()) > kMostNewFactors * static_cast<double>(factors_.size());
}

void IncrementalProblem::apply_factor(std::uint32_t k) {
  Factor& f = factors_[k];
  const bool was_active = active_[k] != 0;
  deactivate(k);
  if (f.kind == Kind::kEdge) f.weight = graph.edges()[f.index].weight;
  if (f.weight == 0.0) {
    edge_removed_ |= was_active;
    return;
  }
  if (f.from != kFixed) cholesky_.insert(f.from, f.to);
  activate(k);
  if (f.kind == Kind::kEdge) join(f);
  if (f.kind == Kind::kPrior) {
    const std::uint32_t root = components_.root(f.to);
    has_prior_[root] = 1;
    release(root);
  }
}

void IncrementalProblem::reorder() {
  register_additions();
  sound_ = false;
  for (const std::uint32_t k : waiting_) {
    Factor& f = factors_[k];
    if (f.kind == Kind::kEdge) f.weight = graph.edges()[f.index].weight;
    active_[k] = f.weight > 0.0 ? 1 : 0;
    reopen(f);
  }
  absorbed_nodes_ = poses.size();
  std::vector<BlockPair> pairs;
  for (std::size_t k = 0; k < factors_.size(); ++k) {
    const Factor& f = factors_[k];
    if (active_[k] != 0 && f.from != kFixed) pairs.emplace_back(f.from, f.to);
  }
  cholesky_.analyze(poses.size(), pairs);
  flops_when_ordered_ = cholesky_.flops();
  flops_of_updates_ = kOrderFlopsPerFactor * static_cast<double>(factors_.size());
  flops_of_last_ = 0.0;
  updates_ = 0;
  cost_ = 0.0;
  std::fill(gradients_.begin(), gradients_.end(), Vector6d::Zero());
  std::fill(diagonals_.begin(), diagonals_.end(), Matrix6d::Zero());
  for (std::size_t k = 0; k < factors_.size(); ++k) {
    Factor& f = factors_[k];
    if (active_[k] == 0) continue;
    evaluate(f, relative_pose(f), f.gradient, f.cost);
    add_to_sums(f);
    linearize_here(static_cast<std::uint32_t>(k));
  }
  find_components();
  waiting_.clear();
  sound_ = true;
}

bool IncrementalProblem::factorize() {
  const double before = cholesky_.flops_spent();
  sound_ = false;
  sound_ = cholesky_.refactorize([this](std::uint32_t node, auto&& add) {
    add(node,
        held(node) ? Matrix6d(diagonals_[node] + kHeldInformation * Matrix6d::Identity()) : diagonals_[node]);
    for (const std::uint32_t k : factors_of_[node]) {
      const Factor& f = factors_[k];
      if (active_[k] == 0) continue;
      const std::uint32_t other = f.to == node ? f.from : f.to;
      if (other == kFixed || cholesky_.position(other) < cholesky_.position(node)) continue;
      add(other, f.to == node ? Matrix6d(crosses_[k].transpose()) : crosses_[k]);
    }
  });
  const double spent = cholesky_.flops_spent() - before;
  if (flops_of_last_ == 0.0 && spent > 0.0) ++updates_;
  flops_of_last_ += spent;
  flops_of_updates_ += spent;
  return sound_;
}

/// Joins the components of an edge's ends. One held node is enough for a component.
void IncrementalProblem::join(const Factor& f) {
  const std::uint32_t a = components_.root(f.from), b = components_.root(f.to);
  if (!components_.join(a, b)) return;
  const auto [root, other] = std::minmax(a, b);
  const bool prior = has_prior_[a] != 0 || has_prior_[b] != 0;
  if (prior || held_at_[root] != kFixed) release(other);
  if (prior) release(root);
  if (held_at_[root] == kFixed) held_at_[root] = std::exchange(held_at_[other], kFixed);
  has_prior_[root] = prior ? 1 : 0;
}

void IncrementalProblem::find_components() {
  edge_removed_ = false;
  components_ = DisjointSets(poses.size());
  has_prior_.assign(poses.size(), 0);
  const std::vector<char> held_before = held_;
  held_at_.assign(poses.size(), kFixed);
  held_.assign(poses.size(), 0);
  for (std::size_t k = 0; k < factors_.size(); ++k) {
    const Factor& f = factors_[k];
    if (active_[k] != 0 && f.kind == Kind::kEdge) components_.join(f.from, f.to);
  }
  for (std::size_t k = 0; k < factors_.size(); ++k) {
    const Factor& f = factors_[k];
    if (active_[k] != 0 && f.kind == Kind::kPrior) has_prior_[components_.root(f.to)] = 1;
  }
  hold_components(0);
  for (std::uint32_t i = 0; i < held_before.size(); ++i) {
    if (held_before[i] == held_[i]) continue;
    cholesky_.touch(i);
    open_.insert(i);
  }
}

/// \param first nodes before this one are already held
void IncrementalProblem::hold_components(std::uint32_t first) {
  for (std::uint32_t i = first; i < poses.size(); ++i) {
    if (components_.root(i) == i && has_prior_[i] == 0 && held_at_[i] == kFixed) hold(i);
  }
}

void IncrementalProblem::hold(std::uint32_t node) {
  held_at_[node] = node;
  held_[node] = 1;
  cholesky_.touch(node);
}

void IncrementalProblem::release(std::uint32_t root) {
  const std::uint32_t node = std::exchange(held_at_[root], kFixed);
  if (node == kFixed) return;
  held_[node] = 0;
  cholesky_.touch(node);
  open_.insert(node);
}

void IncrementalProblem::change_at(const std::vector<std::uint32_t>& nodes) {
  if (nodes.size() < poses.size() / 16) {
    for (const std::uint32_t node : nodes) {
      for (const std::uint32_t k : factors_of_[node]) {
        if (active_[k] != 0) changed_.insert(k);
      }
    }
    return;
  }
  // One pass over all factors is faster than the lists of many nodes.
  std::vector<char> among(poses.size(), 0);
  for (const std::uint32_t node : nodes) among[node] = 1;
  for (std::uint32_t k = 0; k < factors_.size(); ++k) {
    const Factor& f = factors_[k];
    if (active_[k] != 0 && (among[f.to] != 0 || (f.from != kFixed && among[f.from] != 0))) changed_.insert(k);
  }
}

/// The ends of a closure may be anywhere in memory.
void IncrementalProblem::prefetch_poses(const Factor& f) const {
  __builtin_prefetch(poses[f.to].R.data());
  __builtin_prefetch(poses[f.to].t.data());
  if (f.from == kFixed) return;
  __builtin_prefetch(poses[f.from].R.data());
  __builtin_prefetch(poses[f.from].t.data());
}

double IncrementalProblem::evaluate_changed(ThreadPool& pool) {
  struct Evaluation {
    FactorGradient gradient;
    double cost = 0.0;
  };
  constexpr std::size_t kTask = 512, kWave = 32 * kTask, kAhead = 8;
  const double former = cost_;
  changed_.sort();
  const std::vector<std::uint32_t>& numbers = changed_.numbers();
  std::vector<Evaluation> evaluations(std::min(numbers.size(), kWave));
  for (std::size_t begin = 0; begin < numbers.size(); begin += kWave) {
    const std::size_t end = std::min(numbers.size(), begin + kWave);
    pool.for_each((end - begin + kTask - 1) / kTask, [&](std::size_t task) {
      const std::size_t last = std::min(end, begin + (task + 1) * kTask);
      for (std::size_t i = begin + task * kTask; i < last; ++i) {
        if (i + kAhead < last) prefetch_poses(factors_[numbers[i + kAhead]]);
        Evaluation& e = evaluations[i - begin];
        const Factor& f = factors_[numbers[i]];
        const Pose now = relative_pose(f);
        evaluate(f, now, e.gradient, e.cost);
        drift_[numbers[i]] = squared_change(f.linear, now);
      }
    });
    // Summed in the order of the factors, so that the number of threads does not change the result.
    for (std::size_t i = begin; i < end; ++i) {
      Factor& f = factors_[numbers[i]];
      const Evaluation& e = evaluations[i - begin];
      gradients_[f.to] += e.gradient.to - f.gradient.to;
      if (f.from != kFixed) gradients_[f.from] += e.gradient.from - f.gradient.from;
      cost_ += e.cost - f.cost;
      f.gradient = e.gradient;
      f.cost = e.cost;
    }
  }
  return cost_ - former;
}

void IncrementalProblem::evaluate_back(double cost, ThreadPool& pool) {
  evaluate_changed(pool);
  for (const std::uint32_t k : changed_.numbers()) {
    sum_gradient(factors_[k].to);
    if (factors_[k].from != kFixed) sum_gradient(factors_[k].from);
  }
  cost_ = cost;
}

std::size_t IncrementalProblem::relinearize(double share) {
  std::size_t count = 0;
  for (const std::uint32_t k : changed_.numbers()) {
    if (drift_[k] <= share * share) continue;
    add_to_hessian(k, -1.0);
    linearize_here(k);
    ++count;
  }
  return count;
}

void IncrementalProblem::reopen_changed(const NumberSet* within) {
  for (const std::uint32_t k : changed_.numbers()) {
    const Factor& f = factors_[k];
    const bool inside =
        within != nullptr && within->contains(f.to) && (f.from == kFixed || within->contains(f.from));
    if (!inside) reopen(f);
  }
}

}  // namespace loopwise::detail
