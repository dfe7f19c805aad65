// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>

#include "closure_kernels.hpp"

namespace loopwise::detail {

/// A hypothetical closure: a between factor whose measurement is the present estimate. Its residual is
/// therefore zero, J_to = I and J_from = −Ad(T_to⁻¹ T_from). It adds `scale`·JᵀΩJ to the Hessian.
struct ClosureTerm {
  std::uint32_t from = 0;
  std::uint32_t to = 0;
  double scale = 1.0;
  Matrix6d adjoint;  ///< Ad(T_to⁻¹ T_from)
};

/// Connected components of a pose graph, and which of them have a prior.
struct GraphComponents {
  explicit GraphComponents(const PoseGraph& graph);
  std::vector<std::uint32_t> component;  ///< By node.
  std::vector<bool> anchored;            ///< By component: a prior acts in it.

  /// Whether the closure joins two components of which at least one has no prior. It then connects them, and
  /// the trace it would reduce is not defined.
  [[nodiscard]] bool connecting(std::size_t from, std::size_t to) const {
    const std::uint32_t a = component[from], b = component[to];
    return a != b && !(anchored[a] && anchored[b]);
  }
};

/// The Gauss-Newton Hessian of a pose graph plus a changing set of closures, as a block-sparse Cholesky
/// factor of 6×6 blocks. Every factorisation starts from the graph's own blocks, so errors do not accumulate.
/// A component without a prior is held at its first node; nodes without factors are held too.
class ClosureFactor {
 public:
  /// Uses the present weights of the edges. \throws InputError if the graph's numbers are not finite.
  explicit ClosureFactor(const PoseGraph& graph);

  /// Factorises with these closures, each with the information matrix `information`. \throws InputError
  /// naming a node if the factors do not determine its pose.
  void factorize(const std::vector<const ClosureTerm*>& closures, const Matrix6d& information);

  [[nodiscard]] std::size_t free_nodes() const { return variables_; }
  [[nodiscard]] bool held(std::size_t node) const { return variable_[node] == kHeld; }
  [[nodiscard]] std::size_t blocks() const { return rows_.size(); }

  // Columns of Σ and similar matrices are stored as row-major 6×Width blocks, one for each free node in
  // elimination order.

  /// Σ·Jᵀ of several closures side by side, 6 columns each. Width is 6 times their number; the columns of a
  /// null pointer are zero.
  template <int Width>
  void closure_columns(const ClosureTerm* const* closures, std::vector<double>& x) const;
  /// x = Σ·x.
  template <int Width>
  void solve(std::vector<double>& x) const;
  /// x = L⁻ᵀ·x, a square root of Σ: E[x xᵀ] = Σ for white x.
  template <int Width>
  void solve_root(std::vector<double>& x) const;

  /// The block of a node in x, or null if the node is held.
  [[nodiscard]] const double* rows_of(const std::vector<double>& x, std::size_t node, int width) const {
    if (held(node)) return nullptr;
    return x.data() +
           static_cast<std::size_t>(position_[variable_[node]]) * 6 * static_cast<std::size_t>(width);
  }
  /// J·x of a closure as a 6×Width row-major matrix.
  template <int Width>
  void apply(const ClosureTerm& closure, const std::vector<double>& x, double* out) const;

  /// Traces of Σ over all free nodes: of the translations, and of all coordinates. Computed by selected
  /// inversion.
  struct Traces {
    double translation = 0.0;
    double full = 0.0;
  };
  [[nodiscard]] Traces traces() const;
  [[nodiscard]] double log_determinant() const;

 private:
  static constexpr std::uint32_t kHeld = UINT32_MAX;

  struct Pair {
    std::uint32_t a, b;  ///< Variables.
    Matrix6d block;      ///< Of H, rows a, columns b.
  };

  [[nodiscard]] BlockColumns columns() const {
    return {variables_, start_.data(), rows_.data(), values_.data(), inverse_.data()};
  }
  void analyze(const std::vector<const ClosureTerm*>& closures, bool reorder);
  [[nodiscard]] std::size_t slot(std::uint32_t row, std::uint32_t column) const;
  void add_block(std::uint32_t a, std::uint32_t b, const Matrix6d& block);

  std::vector<Key> keys_;                // by variable, for messages
  std::vector<std::uint32_t> variable_;  // by node
  std::size_t variables_ = 0;
  std::vector<Matrix6d> diagonal_;  // of the graph's own H, by variable
  std::vector<Pair> pairs_;

  std::vector<std::uint32_t> order_;     // variable by position
  std::vector<std::uint32_t> position_;  // position by variable
  std::vector<std::uint32_t> parent_;    // elimination tree, by position; own number at a root
  std::vector<std::size_t> start_;       // block columns of L: the diagonal block, then rows ascending
  std::vector<std::uint32_t> rows_;
  std::vector<double> values_;   // 36 a block, column-major
  std::vector<double> inverse_;  // of the diagonal blocks of L, 36 a column
  double work_ = 0.0;            // of the last analysis
  double ordered_work_ = 0.0;    // of the analysis that made the order

  // Scratch of the analysis and the factorisation.
  std::vector<std::vector<std::uint32_t>> columns_, below_;
  std::vector<std::uint32_t> mark_, head_, next_, place_;
  std::vector<std::size_t> cursor_;
};

}  // namespace loopwise::detail
