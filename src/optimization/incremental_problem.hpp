// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/thread_pool.hpp>

#include "linalg/incremental_cholesky.hpp"
#include "linearization.hpp"

namespace loopwise::detail {

/// A set of numbers in the order of their insertion.
class NumberSet {
 public:
  void grow(std::size_t count) { in_.resize(count, 0); }
  void insert(std::uint32_t number) {
    if (in_[number] != 0) return;
    in_[number] = 1;
    numbers_.push_back(number);
  }
  void clear() {
    for (const std::uint32_t number : numbers_) in_[number] = 0;
    numbers_.clear();
  }
  /// Sorts the numbers in ascending order.
  void sort();
  [[nodiscard]] bool contains(std::uint32_t number) const { return in_[number] != 0; }
  [[nodiscard]] const std::vector<std::uint32_t>& numbers() const { return numbers_; }

 private:
  std::vector<char> in_;
  std::vector<std::uint32_t> numbers_;
};

/// A pose graph with the gradient at its poses and a factorised Hessian. Both are kept up to date while
/// factors are added or removed and poses move. Each factor is linearised at poses of its own, near the
/// present ones.
class IncrementalProblem {
 public:
  PoseGraph graph;          ///< Its poses are older than `poses` during an update
  std::vector<Pose> poses;  ///< By node

  /// Records that the edge's weight in `graph` has changed; absorb() applies it.
  void weight_changed(std::size_t edge) { reweighted_.push_back(edge); }

  /// Number of nodes in the Hessian.
  [[nodiscard]] std::size_t absorbed_nodes() const { return absorbed_nodes_; }
  /// Applies additions to `graph` and changes of weights since the last call. It keeps the order of
  /// elimination, or computes a new one if that is necessary or cheaper. \returns whether the order is new
  bool absorb();
  /// Applies all changes with a new order of elimination, linearised at the present poses.
  void reorder();
  /// \returns false if the Hessian is not positive definite
  [[nodiscard]] bool factorize();

  [[nodiscard]] IncrementalCholesky& cholesky() { return cholesky_; }
  [[nodiscard]] double cost() const { return cost_; }
  [[nodiscard]] const Vector6d& gradient(std::uint32_t node) const { return gradients_[node]; }
  /// Whether a node holds its component in place.
  [[nodiscard]] bool held(std::uint32_t node) const { return held_[node] != 0; }
  /// Nodes whose gradient has changed since the set was cleared.
  [[nodiscard]] NumberSet& open() { return open_; }

  /// Empties the set of changed factors.
  void clear_changed() { changed_.clear(); }
  /// Adds the active factors of some nodes to the set of changed factors.
  void change_at(const std::vector<std::uint32_t>& nodes);
  /// Updates cost and gradient of the changed factors. \returns the change of the cost
  double evaluate_changed(ThreadPool& pool);
  /// The same after a step was undone, where the cost was `cost`; removes the rounding errors of both moves.
  void evaluate_back(double cost, ThreadPool& pool);
  /// Linearises those changed factors again whose relative pose has changed by more than `share` (rad, or
  /// share of the length). \returns their number
  std::size_t relinearize(double share);
  /// Makes the nodes of the changed factors open, except for factors with both ends in `within`.
  void reopen_changed(const NumberSet* within = nullptr);

 private:
  static constexpr std::uint32_t kFixed = UINT32_MAX;
  enum class Kind : std::uint8_t { kEdge, kPrior, kRange, kGravity };
  struct Factor {
    Kind kind;
    std::uint32_t index;        ///< In the graph's list of its kind
    std::uint32_t from, to;     ///< Nodes; `from` is kFixed if the factor has only one
    double weight = 1.0;        ///< Of an edge, as of the last absorb() or reorder()
    double cost = 0.0;          ///< At the poses
    FactorGradient gradient{};  ///< At the poses
    Pose linear{};              ///< relative_pose() at its linearisation
  };
  struct Measurement {
    const Eigen::Isometry3d& Z;
    const Matrix6d& information;
  };

  [[nodiscard]] std::uint32_t number(Key key) const {
    return static_cast<std::uint32_t>(graph.index_of(key));
  }
  std::uint32_t add_factor(Kind kind, std::size_t index, std::uint32_t from, std::uint32_t to);

  [[nodiscard]] Pose relative_pose(const Factor& f) const;
  [[nodiscard]] Measurement measurement(const Factor& f) const;
  [[nodiscard]] Contribution contribution(const Factor& f, const Pose& e) const;
  void evaluate(const Factor& f, const Pose& e, FactorGradient& gradient, double& cost) const;
  void prefetch_poses(const Factor& f) const;
  void add_to_sums(const Factor& f);
  void sum_gradient(std::uint32_t node);
  void sum_cost();
  void add_to_hessian(std::uint32_t k, double sign);
  void linearize_here(std::uint32_t k);
  void activate(std::uint32_t k);
  void deactivate(std::uint32_t k);
  void reopen(const Factor& f);

  void register_additions();
  void register_edge(std::size_t edge);
  [[nodiscard]] bool reorder_is_due() const;
  void apply_factor(std::uint32_t k);
  void join(const Factor& f);
  void find_components();
  void hold_components(std::uint32_t first);
  void hold(std::uint32_t node);
  void release(std::uint32_t root);

  std::vector<Factor> factors_;
  std::vector<char> active_;       // by factor
  std::vector<Matrix6d> crosses_;  // by factor: block of the Hessian, rows of `to`, columns of `from`
  std::vector<double> drift_;  // by factor: square of the change of its relative pose since Factor::linear
  std::vector<std::uint32_t> edge_factor_;              // by edge
  std::vector<std::vector<std::uint32_t>> factors_of_;  // by node
  std::vector<std::uint32_t> waiting_;                  // factors that are new or have a new weight
  std::vector<std::size_t> reweighted_;                 // edges
  std::size_t known_priors_ = 0, known_ranges_ = 0, known_gravities_ = 0;
  std::size_t absorbed_nodes_ = 0;

  DisjointSets components_{0};
  std::vector<char> has_prior_;         // by component's root
  std::vector<std::uint32_t> held_at_;  // by component's root without a prior: the node that holds it
  std::vector<char> held_;              // by node
  bool edge_removed_ = false;           // an edge was removed, so components may have separated

  IncrementalCholesky cholesky_;
  std::vector<Matrix6d> diagonals_;  // by node: its block of the Hessian
  std::vector<Vector6d> gradients_;  // by node, at the poses
  double cost_ = 0.0;
  NumberSet open_;                   // nodes
  bool sound_ = true;                // the last factorisation succeeded
  NumberSet changed_;                // factors
  double flops_when_ordered_ = 0.0;  // of one complete factorisation
  double flops_of_updates_ = 0.0;    // of all updates since the last order, with an estimate for that
  double flops_of_last_ = 0.0;       // of the last update
  std::size_t updates_ = 0;          // with a factorisation since the last order
};

}  // namespace loopwise::detail
