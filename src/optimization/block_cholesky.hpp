// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/optimization/optimizer.hpp>

#include "multifrontal.hpp"
#include "panels.hpp"

namespace loopwise::detail {

/// A symmetric positive definite matrix of square blocks and its Cholesky factor, computed by our own fronts
/// or by CHOLMOD. CHOLMOD computes the fill-reducing ordering on the graph of blocks. The matrix is stored in
/// that order, so that both can use it directly.
class BlockCholesky {
 public:
  using Pair = std::pair<std::uint32_t, std::uint32_t>;

  /// Position of a block among the values: element (r, c) at offset + c·stride + r, or transposed.
  struct Slot {
    std::size_t offset = 0;
    std::uint32_t stride = 0;
    bool transposed = false;
  };

  BlockCholesky(int block_size, Factorization factorization);
  ~BlockCholesky();
  BlockCholesky(const BlockCholesky&) = delete;
  BlockCholesky& operator=(const BlockCholesky&) = delete;

  /// Orders and analyses a matrix with `variables` block rows and with off-diagonal blocks at `pairs`; pairs
  /// may repeat, in either direction. \throws Error if the factor would be too large.
  void analyze(std::size_t variables, const std::vector<Pair>& pairs);

  [[nodiscard]] std::size_t variables() const { return variables_; }
  [[nodiscard]] int block_size() const { return block_; }
  /// As given to analyze().
  [[nodiscard]] const std::vector<Pair>& pairs() const { return pairs_; }
  /// Slot of pair k of analyze(), seen as block (first, second).
  [[nodiscard]] const Slot& pair_slot(std::size_t k) const { return pair_slots_[k]; }
  [[nodiscard]] const Slot& diagonal_slot(std::size_t variable) const { return diagonal_slots_[variable]; }
  /// Position of the variable in the elimination order.
  [[nodiscard]] std::uint32_t position(std::size_t variable) const { return position_[variable]; }
  /// Block column of the values that holds pair k.
  [[nodiscard]] std::uint32_t pair_column(std::size_t k) const { return pair_columns_[k]; }

  [[nodiscard]] std::vector<double>& values() { return values_; }
  void set_zero();
  [[nodiscard]] Eigen::VectorXd diagonal() const;
  void set_diagonal(const Eigen::VectorXd& diagonal);

  /// \returns false if the matrix is not positive definite. A simplicial factor of an indefinite matrix may
  /// exist: check smallest_pivot() before using it.
  /// \param pool for the fronts, or null; it never changes the result
  [[nodiscard]] bool factorize(ThreadPool* pool = nullptr);
  /// After factorize(): smallest ratio of a pivot to the matrix's diagonal element, in (0, 1], and its
  /// variable. The ratio is 0 if the factorisation failed.
  [[nodiscard]] std::pair<double, std::size_t> smallest_pivot() const;
  /// Solves in place for one right-hand side, in the order of the variables.
  void solve(Eigen::VectorXd& x) const;
  void solve(Eigen::MatrixXd& x) const;
  /// bᵀH⁻¹b. Cheaper than solve() if b is sparse.
  [[nodiscard]] Eigen::MatrixXd inverse_between(const Eigen::MatrixXd& b) const;

  /// The factorisation in use; never kAutomatic.
  [[nodiscard]] Factorization factorization() const { return chosen_; }
  [[nodiscard]] double factor_nonzeros() const { return factor_nonzeros_; }
  [[nodiscard]] double factor_flops() const { return factor_flops_; }
  [[nodiscard]] double log_determinant() const;
  /// L as panels; rows and columns are in elimination order.
  [[nodiscard]] Panels panels() const;
  /// The same, without a copy where possible. Call factorize() again before any other use of the factor.
  [[nodiscard]] Panels take_panels();
  /// The fronts of the analysis. \pre factorization() is kMultifrontal, and there are variables
  [[nodiscard]] FrontShape front_shape() const { return fronts_->front_shape(); }

 private:
  struct Cholmod;
  void order(const std::vector<Pair>& upper);
  void choose();
  /// Pattern of the pairs: block columns of the lower or the upper triangle, in elimination order.
  [[nodiscard]] BlockPattern pattern(const std::vector<Pair>& upper, bool lower) const;
  void lay_out(const BlockPattern& columns, bool lower);
  void lay_out_scalars(const BlockPattern& columns);
  void make_symbolic_factor();
  [[nodiscard]] std::vector<double> cholmod_pivots() const;

  int block_;
  Factorization choice_;
  std::size_t variables_ = 0;
  Factorization chosen_ = Factorization::kMultifrontal;
  double factor_nonzeros_ = 0.0;
  double factor_flops_ = 0.0;
  std::vector<std::uint32_t> position_;
  std::vector<Pair> pairs_;
  std::vector<Slot> pair_slots_;
  std::vector<std::uint32_t> pair_columns_;
  std::vector<Slot> diagonal_slots_;
  std::vector<double> values_;
  std::vector<int> column_start_;  // scalar columns of the matrix, in CHOLMOD's layout
  std::vector<int> row_index_;
  std::vector<int> block_parent_, block_count_;  // elimination tree and column counts of L, by position
  std::unique_ptr<Cholmod> cholmod_;
  std::unique_ptr<MultifrontalCholesky> fronts_;
};

}  // namespace loopwise::detail
