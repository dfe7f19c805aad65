// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "linalg/block_cholesky.hpp"
#include "linearization.hpp"

namespace loopwise::detail {

/// A pose graph in the layout for solving. Factor k is edge k of the graph; the priors follow as edges from a
/// last, fixed node at the origin. A factor of weight 0 is not used. Ranges and gravity, the auxiliary
/// factors, are few; they are stored separately and are not among factors().
class PoseProblem {
 public:
  explicit PoseProblem(const PoseGraph& graph);

  [[nodiscard]] std::size_t nodes() const { return nodes_; }
  [[nodiscard]] std::size_t edges() const { return edges_; }
  [[nodiscard]] bool planar() const { return planar_; }
  [[nodiscard]] std::size_t factors() const { return from_.size(); }
  [[nodiscard]] std::uint32_t from(std::size_t k) const { return from_[k]; }
  [[nodiscard]] std::uint32_t to(std::size_t k) const { return to_[k]; }
  [[nodiscard]] const Matrix6d& information(std::size_t k) const { return information_[k]; }
  /// A range between two nodes.
  struct Ranging {
    std::uint32_t from;
    std::uint32_t to;
    RangeFactor factor;
  };
  /// Gravity at a node.
  struct Levelling {
    std::uint32_t node;
    GravityFactor factor;
  };
  [[nodiscard]] const std::vector<Ranging>& ranges() const { return ranges_; }
  [[nodiscard]] const std::vector<Levelling>& gravities() const { return gravities_; }
  [[nodiscard]] const Pose& inverse_measurement(std::size_t k) const { return inverse_[k]; }

  /// Weights of all factors; priors have 1.
  std::vector<double> weight;

  /// Poses with the fixed node at the end.
  [[nodiscard]] std::vector<Pose> poses_of(const std::vector<Eigen::Isometry3d>& poses) const;
  [[nodiscard]] std::vector<Eigen::Isometry3d> isometries(const std::vector<Pose>& poses) const;

  [[nodiscard]] Vector6d residual(std::size_t k, const std::vector<Pose>& poses) const;
  /// rᵀΩr of a factor, without its weight.
  [[nodiscard]] double squared_residual(std::size_t k, const std::vector<Pose>& poses) const;
  /// ½ Σ ‖r‖² over the auxiliary factors.
  [[nodiscard]] double auxiliary_cost(const std::vector<Pose>& poses) const;
  /// ½ Σ w rᵀΩr plus auxiliary_cost(), summed in an order that does not depend on the threads. Stores the
  /// residuals of the active factors.
  double cost(const std::vector<Pose>& poses, ThreadPool& pool, std::vector<Vector6d>& residuals) const;

 private:
  std::size_t nodes_;
  std::size_t edges_;
  bool planar_;
  std::vector<std::uint32_t> from_, to_;
  std::vector<Pose> inverse_;
  std::vector<Matrix6d> information_;
  std::vector<Ranging> ranges_;
  std::vector<Levelling> gravities_;
};

/// The nodes of a problem that can move, given its weights.
struct Freedom {
  static constexpr std::uint32_t kFixed = UINT32_MAX;
  std::vector<std::uint32_t> variable;  ///< By node, the fixed one included; kFixed if it does not move.
  std::vector<std::uint32_t> nodes;     ///< By variable.
  /// By node: the smallest node of its component by active factors; kFixed for a node without active factors.
  std::vector<std::uint32_t> component;
  std::vector<std::size_t> held;  ///< Nodes that hold a component without a prior, ascending.
};
[[nodiscard]] Freedom find_freedom(const PoseProblem& problem);

/// The structure of a problem's Gauss-Newton system for the factors of non-zero weight.
struct SystemStructure {
  SystemStructure() = default;
  explicit SystemStructure(const PoseProblem& problem);

  Freedom freedom;
  std::vector<std::uint32_t> active;   ///< Factors with a free end, of non-zero weight.
  std::vector<std::uint32_t> pair_of;  ///< By active factor: its pair, or kFixed.
  /// Off-diagonal blocks, as (to, from). Pairs of ranges are last, in the order of the ranges.
  std::vector<BlockPair> pairs;
  std::size_t first_range_pair = 0;
};

/// H = Σ w JᵀΩJ and g = Σ w JᵀΩr over the free nodes, at poses with these residuals (PoseProblem::cost). In a
/// planar problem the rows of z, roll and pitch are the identity in H and 0 in g, so that solutions stay in
/// the plane.
/// \param hessian a matrix over the variables and pairs of the structure
void linearize(const PoseProblem& problem, const SystemStructure& structure, const std::vector<Pose>& poses,
               const std::vector<Vector6d>& residuals, ThreadPool& pool, BlockMatrix& hessian,
               Eigen::VectorXd& gradient);

/// The Gauss-Newton system of a problem for one set of active factors. It may outlive the problem: its
/// symbolic analysis is valid for every problem of the same structure.
class NormalEquations {
 public:
  explicit NormalEquations(Factorization factorization) : cholesky_(6, factorization) {}

  /// Sets the structure to the factors of non-zero weight. Makes a new symbolic analysis if the structure has
  /// changed.
  void set_structure(const PoseProblem& problem);
  /// Computes the system, see detail::linearize(). \pre set_structure(problem)
  void linearize(const PoseProblem& problem, const std::vector<Pose>& poses,
                 const std::vector<Vector6d>& residuals, ThreadPool& pool);
  /// g alone.
  void linearize_gradient(const PoseProblem& problem, const std::vector<Pose>& poses,
                          const std::vector<Vector6d>& residuals);

  [[nodiscard]] BlockCholesky& hessian() { return cholesky_; }
  [[nodiscard]] const BlockCholesky& hessian() const { return cholesky_; }
  [[nodiscard]] const Eigen::VectorXd& gradient() const { return gradient_; }
  [[nodiscard]] const Freedom& freedom() const { return structure_.freedom; }
  [[nodiscard]] std::size_t analyses() const { return analyses_; }

  /// T ⊕ step for every free node.
  [[nodiscard]] std::vector<Pose> moved(const std::vector<Pose>& poses, const Eigen::VectorXd& step) const;

 private:
  BlockCholesky cholesky_;
  SystemStructure structure_;
  Eigen::VectorXd gradient_;
  bool analysed_ = false;  // the pairs of the structure are analysed completely
  std::size_t analyses_ = 0;
};

}  // namespace loopwise::detail
