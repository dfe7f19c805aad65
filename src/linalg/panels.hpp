// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/se3.hpp>

#include "dense_kernels.hpp"

namespace loopwise::detail {

/// L of a factorisation of 6×6 blocks as dense panels, in postorder of the elimination tree. Panel s holds
/// the block columns first[s] … first[s+1]−1 of L in their own rows and in the block rows rows[row_start[s]]
/// … below. It is stored column by column from values[value_start[s]].
struct Panels {
  std::vector<std::uint32_t> first;  ///< Block column, by panel; one more at the end.
  std::vector<std::uint32_t> owner;  ///< Panel, by block column.
  std::vector<int> parent;           ///< Panel of the first row below, -1 for a root.
  std::vector<std::size_t> row_start{0};
  std::vector<std::uint32_t> rows;
  std::vector<std::size_t> value_start{0};
  std::vector<double> values;   ///< Entries above the diagonal of the square part are undefined.
  std::vector<double> inverse;  ///< Of the 6×6 diagonal blocks of L, row-major: invert_diagonal().

  [[nodiscard]] std::size_t size() const { return first.empty() ? 0 : first.size() - 1; }
  [[nodiscard]] std::size_t block_columns() const { return first.empty() ? 0 : first.back(); }
  /// Columns of a panel, and its rows below them.
  [[nodiscard]] int columns(std::size_t s) const { return 6 * static_cast<int>(first[s + 1] - first[s]); }
  [[nodiscard]] int below(std::size_t s) const {
    return 6 * static_cast<int>(row_start[s + 1] - row_start[s]);
  }
  [[nodiscard]] int height(std::size_t s) const { return columns(s) + below(s); }
  [[nodiscard]] PanelView view() const {
    return {size(),        first.data(),  row_start.data(), rows.data(), value_start.data(),
            values.data(), inverse.data()};
  }
};

/// Computes `inverse`, which substitution with several right-hand sides and selected inversion need.
LOOPWISE_EXPORT void invert_diagonal(Panels& l);
/// log det(L Lᵀ)
[[nodiscard]] LOOPWISE_EXPORT double log_determinant(const Panels& l);

/// x = (L Lᵀ)⁻¹ x in place; rows in elimination order. \pre invert_diagonal()
LOOPWISE_EXPORT void solve(const Panels& l, Eigen::MatrixXd& x);
/// x = L⁻ᵀ x in place. \pre invert_diagonal()
LOOPWISE_EXPORT void solve_transposed(const Panels& l, Eigen::MatrixXd& x);

/// The steps of substitution with a right-hand side that is non-zero in these block columns: their paths to
/// the roots of the tree.
[[nodiscard]] LOOPWISE_EXPORT std::vector<PathStep> sparse_path(const Panels& l,
                                                                std::vector<std::uint32_t> columns);

/// bᵀ(L Lᵀ)⁻¹b for right-hand sides of six columns with few non-zero blocks: forward substitution along their
/// paths to the roots of the tree.
class LOOPWISE_EXPORT SparseInverse {
 public:
  explicit SparseInverse(Panels l);
  struct Block {
    std::uint32_t column = 0;  ///< Block column of L, which is a block row of b
    Matrix6d value = Matrix6d::Zero();
  };
  [[nodiscard]] Matrix6d between(const std::vector<Block>& b);

 private:
  Panels l_;
  std::vector<double> x_;  // a row-major 6×6 block for each block column; zero between calls
};

}  // namespace loopwise::detail
