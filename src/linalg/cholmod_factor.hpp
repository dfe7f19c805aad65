// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include <Eigen/Core>

#include "elimination.hpp"
#include "panels.hpp"

namespace loopwise::detail {

/// CHOLMOD's Cholesky factor, simplicial or supernodal, of a matrix of blocks of any size in a given order of
/// elimination.
class CholmodFactor {
 public:
  /// \param pattern of the matrix in that order: its upper triangle for simplicial, its lower one for
  ///        supernodal. \throws Error if the factor would be too large
  CholmodFactor(int block_size, bool supernodal, const BlockPattern& pattern, const Elimination& elimination);
  ~CholmodFactor();
  CholmodFactor(const CholmodFactor&) = delete;
  CholmodFactor& operator=(const CholmodFactor&) = delete;

  /// \param values of the pattern's scalar columns. \returns false if the matrix is not positive definite
  [[nodiscard]] bool factorize(std::vector<double>& values);
  /// Block column at which the last factorisation failed; the number of columns or more if it succeeded.
  [[nodiscard]] std::size_t broken_at() const;
  [[nodiscard]] std::vector<double> pivots() const;
  /// Solves in place; rows in elimination order.
  void solve(Eigen::MatrixXd& x);
  /// A copy of L. \pre the blocks are 6×6
  [[nodiscard]] Panels panels() const;

 private:
  struct Workspace;
  void lay_out(const BlockPattern& pattern);
  void make_symbolic_factor(const Elimination& elimination);
  void copy_supernodes(Panels& out) const;
  void copy_columns(Panels& out) const;

  int block_;
  bool supernodal_;
  std::size_t variables_;
  std::vector<int> column_start_, row_index_;  // scalar columns of the matrix
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace loopwise::detail
