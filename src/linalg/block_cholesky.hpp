// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/linalg/factorization.hpp>

#include "block_matrix.hpp"
#include "elimination.hpp"
#include "multifrontal.hpp"
#include "panels.hpp"

namespace loopwise::detail {

class CholmodFactor;

/// A symmetric positive definite matrix of square blocks and its Cholesky factor, computed by our own fronts
/// or by CHOLMOD. The matrix is stored in the order of elimination, so that both can use it directly.
class LOOPWISE_EXPORT BlockCholesky {
 public:
  using Pair = BlockPair;
  using Slot = BlockMatrix::Slot;

  /// \param rounding of the fronts. CHOLMOD's factorisations are always kFastest.
  BlockCholesky(int block_size, Factorization factorization, Rounding rounding = Rounding::kFastest);
  ~BlockCholesky();
  BlockCholesky(const BlockCholesky&) = delete;
  BlockCholesky& operator=(const BlockCholesky&) = delete;

  /// Orders and analyses a matrix with `variables` block rows and with off-diagonal blocks at `pairs`; pairs
  /// may repeat, in either direction. The values become undefined. \throws Error if the factor would be too
  /// large.
  void analyze(std::size_t variables, const std::vector<Pair>& pairs);
  /// The same for other pairs of the same variables, in the order of the last call of analyze() as long as
  /// that costs little more than then. Until a new order is made, the same pairs give the same factor.
  void analyze_again(const std::vector<Pair>& pairs);

  /// The matrix; its values may change between calls of factorize().
  [[nodiscard]] BlockMatrix& matrix() { return matrix_; }
  [[nodiscard]] const BlockMatrix& matrix() const { return matrix_; }
  [[nodiscard]] std::size_t variables() const { return matrix_.variables(); }
  [[nodiscard]] int block_size() const { return block_; }
  /// Position of the variable in the elimination order.
  [[nodiscard]] std::uint32_t position(std::size_t variable) const { return matrix_.position(variable); }

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

  /// The factorisation in use; never kAutomatic.
  [[nodiscard]] Factorization factorization() const { return chosen_; }
  [[nodiscard]] double factor_nonzeros() const { return factor_nonzeros_; }
  [[nodiscard]] double factor_flops() const { return factor_flops_; }
  /// Of the matrix. \pre factorize() returned true
  [[nodiscard]] double log_determinant() const;
  /// L of 6×6 blocks as panels; rows and columns are in elimination order.
  [[nodiscard]] Panels panels() const;
  /// The same, without a copy where possible. Call analyze() before any other use of the factor.
  [[nodiscard]] Panels take_panels();
  /// L without a copy. \pre factorization() is kMultifrontal
  [[nodiscard]] Panels& fronts() { return fronts_.panels(); }
  [[nodiscard]] const Panels& fronts() const { return fronts_.panels(); }

 private:
  void analyze(Elimination elimination, const std::vector<Pair>& pairs);
  void count(const Elimination& elimination);
  [[nodiscard]] std::size_t variable_at(std::size_t place) const;
  void choose();
  [[nodiscard]] bool multifrontal() const { return chosen_ == Factorization::kMultifrontal; }

  int block_;
  Factorization choice_;
  Rounding rounding_;
  Factorization chosen_ = Factorization::kMultifrontal;
  double factor_nonzeros_ = 0.0;
  double factor_flops_ = 0.0;
  std::vector<std::uint32_t> order_;  // of the last new order: variables by position
  double ordered_work_ = 0.0;         // its work
  BlockMatrix matrix_;
  MultifrontalCholesky fronts_;
  std::unique_ptr<CholmodFactor> cholmod_;
};

}  // namespace loopwise::detail
