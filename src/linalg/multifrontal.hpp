// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/thread_pool.hpp>

#include "elimination.hpp"
#include "front.hpp"
#include "panels.hpp"

namespace loopwise::detail {

/// Below this ratio of a pivot to the matrix's diagonal element, rounding dominates the pivot: the matrix
/// counts as singular.
inline constexpr double kSingularPivot = 1e-14;

/// Cholesky factorisation of a symmetric matrix of 6×6 blocks by fronts (Duff and Reid, 1983). Columns of L
/// with the same rows are one dense panel; their update of later columns is a dense matrix that the parent in
/// the elimination tree adds. Columns are in postorder. Pose graphs have hundreds of small fronts, for which
/// the kernels are made.
class LOOPWISE_EXPORT MultifrontalCholesky {
 public:
  explicit MultifrontalCholesky(Rounding rounding) : kernels_(dense_kernels(rounding)) {}

  /// Reuses the memory of the last analysis.
  /// \param most_zeros how far panels with different rows are merged, relative to what is best for a single
  ///        right-hand side: 1 or less. Each right-hand side costs a product with the added zeros.
  void analyze(const Elimination& elimination, double most_zeros);

  /// \param values the blocks of the pattern one after the other, 36 values each, column-major; only the
  ///        lower triangle of diagonal blocks is used.
  /// \param pool for independent subtrees of the elimination tree, or null; it never changes the result
  /// \returns false if the matrix is not positive definite.
  [[nodiscard]] bool factorize(const double* values, ThreadPool* pool = nullptr);
  /// The smallest ratio of a pivot to the matrix's diagonal element, and its block column.
  struct Pivot {
    double ratio = 1.0;
    std::size_t column = 0;
  };
  /// Of the last factorisation; the ratio is 0 at the column at which it failed.
  [[nodiscard]] const Pivot& smallest_pivot() const { return smallest_; }

  /// Solves L·Lᵀ·x = y in place.
  void solve(double* x) const;
  /// x := L⁻¹x. Fronts whose part of x is zero are skipped.
  void solve_lower(double* x) const;
  /// L; after the analysis alone without values.
  [[nodiscard]] const Panels& panels() const { return l_; }
  [[nodiscard]] Panels& panels() { return l_; }

 private:
  /// x := L⁻ᵀx
  void solve_upper(double* x) const;
  /// Number of doubles in a panel's update for its parent.
  [[nodiscard]] std::size_t update_size(std::size_t s) const {
    const auto m = static_cast<std::size_t>(l_.below(s));
    return m * m;
  }
  struct Run;
  /// Panels begin … end − 1, the last of which is the root of the subtree.
  struct Subtree {
    std::size_t begin, end, stack_size;
  };
  [[nodiscard]] bool factorize_range(std::size_t begin, std::size_t end, const double* values, Run& run);
  [[nodiscard]] bool account(const Run& run, bool sound);
  void find_smallest_pivot(std::size_t s, const double* values, const double* l, Pivot& smallest) const;
  [[nodiscard]] std::vector<Subtree> independent_subtrees() const;
  [[nodiscard]] std::size_t stack_size(std::size_t begin, std::size_t end) const;
  void make_panels(const std::vector<int>& parent, const std::vector<int>& count, double most_zeros);
  void make_rows(const BlockPattern& pattern);
  void load_panel(std::size_t s, const double* values, double* l) const;
  void add_child(std::size_t child, const double* update, std::size_t s, double* l, double* u) const;

  const DenseKernels& kernels_;
  Panels l_;
  std::vector<std::uint32_t> relative_;   // rows of l_ as block rows of the parent's front
  std::vector<std::size_t> block_start_;  // of a block column's blocks in the matrix
  struct Place {
    std::uint32_t row, column;  // scalar, in the panel
  };
  std::vector<Place> places_;  // of the matrix's blocks
  std::size_t stack_size_ = 0;
  Pivot smallest_;
  std::unique_ptr<double[]> stack_;  // waiting updates
  std::size_t stack_capacity_ = 0;
};

}  // namespace loopwise::detail
