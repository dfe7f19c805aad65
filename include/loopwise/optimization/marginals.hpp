// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise {

/// A covariance over two poses, each [translation, rotation].
using Matrix12d = Eigen::Matrix<double, 12, 12>;

/// Marginal covariances of the poses: right perturbation, order [translation, rotation], m and rad, body
/// frame. Those of a planar graph are zero in z, roll and pitch, which therefore do not contribute to the
/// traces.
struct Marginals {
  std::vector<Matrix6d> covariances;  ///< One per node, in graph order; zero for nodes with a fixed pose.
  double trace_translation = 0.0;     ///< Sum of the translational variances, m².
  double trace_full = 0.0;            ///< Sum of all variances.
};

/// Covariances at the graph's poses with the edges' weights, i.e. the diagonal blocks of the inverse
/// Gauss-Newton Hessian. A component without a prior is anchored at its first node (covariance zero there):
/// its covariances are relative to that node. Nodes without any factor also have covariance zero, although
/// their uncertainty is unknown. \throws InputError naming a node if the
/// factors do not determine its pose.
[[nodiscard]] LOOPWISE_EXPORT Marginals marginals(const PoseGraph& graph,
                                                  const OptimizerOptions& options = {});

/// The factorised Gauss-Newton Hessian H = Σ w JᵀΩJ of a graph at its poses, with functions of Σ = H⁻¹.
/// Coordinates: node i of the graph owns rows 6i … 6i+5. Nodes with a fixed pose (see Marginals) count as
/// known exactly: their rows and columns of Σ are zero. So are those of z, roll and pitch in a planar graph,
/// whose rows of H are those of the identity. Immutable; const calls are safe from several threads.
class LOOPWISE_EXPORT HessianFactor {
 public:
  /// Linearises, orders and factorises. Of the options, factorization and threads are used.
  /// \throws InputError naming a node if H is singular there.
  explicit HessianFactor(const PoseGraph& graph, const OptimizerOptions& options = {});
  ~HessianFactor();
  HessianFactor(HessianFactor&&) noexcept;
  HessianFactor& operator=(HessianFactor&&) noexcept;

  /// 6 times the number of nodes.
  [[nodiscard]] Eigen::Index dimension() const;
  /// Whether the node has a fixed pose and counts as known exactly. \throws InputError without such a node.
  [[nodiscard]] bool held(std::size_t node) const;

  /// Σ · rhs. rhs has dimension() rows.
  [[nodiscard]] Eigen::MatrixXd solve(const Eigen::MatrixXd& rhs) const;
  /// A matrix square root of Σ applied to the right-hand side: X with E[X Xᵀ] = Σ for white rhs.
  [[nodiscard]] Eigen::MatrixXd solve_root(const Eigen::MatrixXd& rhs) const;
  /// The six columns of Σ of a node. \throws InputError without such a node.
  [[nodiscard]] Eigen::Matrix<double, Eigen::Dynamic, 6> columns(std::size_t node) const;

  /// All 6×6 diagonal blocks of Σ by selected inversion of the factor.
  [[nodiscard]] Marginals marginals() const;
  /// Σ over the two nodes of each pair, in the order of the pair. \throws InputError without such a node.
  [[nodiscard]] std::vector<Matrix12d> joint(
      const std::vector<std::pair<std::size_t, std::size_t>>& pairs) const;

  /// The marginals after adding these edges (between nodes of the graph, r ignored, linearised at the graph's
  /// poses): a low-rank update of `base`, without another factorisation. Efficient for few edges.
  [[nodiscard]] Marginals marginals_with(const std::vector<Edge>& edges, const Marginals& base) const;

  /// log det H over the free poses; for a planar graph, over the three planar rows of each pose.
  [[nodiscard]] double log_determinant() const;
  /// Non-zeros of the factor.
  [[nodiscard]] double factor_nonzeros() const;
  /// The factorisation that was used; never kAutomatic.
  [[nodiscard]] Factorization factorization() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
