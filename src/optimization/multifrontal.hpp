// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include <loopwise/core/thread_pool.hpp>

#include "panels.hpp"

namespace loopwise::detail {

/// Lower triangle of a matrix of blocks: rows[start[v]] … of block column v, ascending, v itself first.
struct BlockPattern {
  std::vector<std::size_t> start;
  std::vector<std::uint32_t> rows;
};

/// The block columns of each front, and the block rows below them.
struct FrontShape {
  std::vector<std::uint32_t> first;    ///< Block column, by front; one more at the end.
  std::vector<int> parent;             ///< Front, -1 for a root
  std::vector<std::size_t> row_start;  ///< Into rows, by front; one more at the end.
  std::vector<std::uint32_t> rows;
};

/// Cholesky factorisation of a symmetric matrix of 6×6 blocks by fronts (Duff and Reid, 1983). Columns of L
/// with the same rows are one dense panel; their update of later columns is a dense matrix that the parent in
/// the elimination tree adds. Columns are in postorder. Pose graphs have hundreds of small fronts, for which
/// the kernels here are made; BLAS computes the large ones.
class MultifrontalCholesky {
 public:
  /// \param parent of each block column in the elimination tree, -1 for a root
  /// \param count  blocks in each block column of L, the diagonal one included
  MultifrontalCholesky(const BlockPattern& pattern, const std::vector<int>& parent,
                       const std::vector<int>& count);

  /// \param values the blocks of the pattern one after the other, 36 values each, column-major; only the
  /// lower
  ///        triangle of diagonal blocks is used.
  /// \param pool for independent subtrees of the elimination tree, or null; it never changes the result
  /// \returns false if the matrix is not positive definite.
  [[nodiscard]] bool factorize(const double* values, ThreadPool* pool = nullptr);
  /// Block column at which the last factorisation failed; the number of columns if it succeeded.
  [[nodiscard]] std::size_t broken_at() const { return broken_at_; }

  /// Solves L·Lᵀ·x = y in place.
  void solve(double* x) const;
  /// x := L⁻¹x. Fronts whose part of x is zero are skipped.
  void solve_lower(double* x) const;
  /// Squares of the diagonal of L. \pre factorize() was successful
  [[nodiscard]] std::vector<double> pivots() const;
  [[nodiscard]] Panels panels() const;
  [[nodiscard]] FrontShape front_shape() const { return {first_, parent_, row_start_, rows_}; }
  /// The same without a copy; the next factorisation allocates again.
  [[nodiscard]] Panels take_panels();

 private:
  /// x := L⁻ᵀx
  void solve_upper(double* x) const;
  [[nodiscard]] std::size_t size() const { return first_.size() - 1; }
  [[nodiscard]] int width(std::size_t s) const { return 6 * static_cast<int>(first_[s + 1] - first_[s]); }
  [[nodiscard]] int below(std::size_t s) const {
    return 6 * static_cast<int>(row_start_[s + 1] - row_start_[s]);
  }
  /// Number of doubles in a panel's update for its parent.
  [[nodiscard]] std::size_t update_size(std::size_t s) const {
    const auto m = static_cast<std::size_t>(below(s));
    return m * m;
  }
  struct Run;
  /// Panels begin … end − 1, the last of which is the root of the subtree.
  struct Subtree {
    std::size_t begin, end, stack_size;
  };
  [[nodiscard]] bool factorize_range(std::size_t begin, std::size_t end, const double* values, Run& run);
  [[nodiscard]] bool broken(const Run& run);
  [[nodiscard]] std::vector<Subtree> independent_subtrees() const;
  [[nodiscard]] std::size_t stack_size(std::size_t begin, std::size_t end) const;
  void make_panels(const std::vector<int>& parent, const std::vector<int>& count);
  void make_rows(const BlockPattern& pattern);
  void load_panel(std::size_t s, const double* values, double* l) const;
  void add_child(std::size_t child, const double* update, std::size_t s, double* l, double* u) const;
  [[nodiscard]] Panels shape() const;

  std::vector<std::uint32_t> first_;      // block column, by panel
  std::vector<int> parent_;               // of a panel
  std::vector<std::size_t> row_start_;    // into rows_ and relative_
  std::vector<std::uint32_t> rows_;       // block rows below a panel's columns
  std::vector<std::uint32_t> relative_;   // the same as block rows of the parent's front
  std::vector<std::size_t> value_start_;  // of a panel in values_
  std::vector<std::size_t> block_start_;  // of a panel's blocks in the matrix
  struct Place {
    std::uint32_t row, column;  // scalar, in the panel
  };
  std::vector<Place> places_;  // of the matrix's blocks
  std::size_t stack_size_ = 0;
  std::size_t broken_at_ = 0;
  std::unique_ptr<double[]> stack_;  // waiting updates
  std::vector<double> values_;
};

}  // namespace loopwise::detail
