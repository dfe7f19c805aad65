// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>

#include "linalg/block_cholesky.hpp"
#include "optimization/graph_hessian.hpp"

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

/// The Gauss-Newton Hessian of a pose graph plus a changing set of closures, and its Cholesky factor. Every
/// factorisation starts from the graph's own blocks, so errors do not accumulate. A component without a prior
/// is held at its first node; nodes without factors are held too. Results are the same to the bit on all
/// processors of a family, so that a choice of closures never depends on the processor.
class ClosureFactor {
 public:
  /// Uses the present weights of the edges. \throws InputError if the graph's numbers are not finite.
  explicit ClosureFactor(const PoseGraph& graph);

  /// Factorises with these closures, each with the information matrix `information`. \throws InputError
  /// naming a node if the factors do not determine its pose.
  void factorize(const std::vector<const ClosureTerm*>& closures, const Matrix6d& information);

  [[nodiscard]] std::size_t free_nodes() const { return graph_.nodes.size(); }
  [[nodiscard]] bool held(std::size_t node) const { return graph_.variable[node] == GraphHessian::kHeld; }

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
    return x.data() + std::size_t{position(node)} * 6 * static_cast<std::size_t>(width);
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
  [[nodiscard]] double log_determinant() const { return cholesky_.log_determinant(); }

 private:
  [[nodiscard]] std::uint32_t position(std::size_t node) const {
    return cholesky_.position(graph_.variable[node]);
  }
  void load(const std::vector<const ClosureTerm*>& closures, const Matrix6d& information);

  std::vector<Key> keys_;  // by variable, for messages
  GraphHessian graph_;
  BlockCholesky cholesky_;
  bool ordered_ = false;
};

}  // namespace loopwise::detail
