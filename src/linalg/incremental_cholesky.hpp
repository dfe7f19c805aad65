// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/core/se3.hpp>

#include "multifrontal.hpp"

namespace loopwise::detail {

/// The Cholesky factor of a growing matrix of 6×6 blocks. Blocks may change, appear between existing
/// variables, or come with new variables, which are last in the order of elimination. refactorize() computes
/// the fronts of changed columns again, and all fronts above them in the elimination tree. Every front keeps
/// its update matrix for the parent, so the memory is several times that of the factor.
class LOOPWISE_EXPORT IncrementalCholesky {
 public:
  /// Computes a new ordering of a matrix with these off-diagonal blocks; pairs may repeat, in either
  /// direction.
  void analyze(std::size_t variables, const std::vector<BlockPair>& pairs);
  /// Adds a variable.
  void append();
  /// Adds an off-diagonal block. A block that already exists is only marked as changed.
  void insert(std::uint32_t a, std::uint32_t b);
  /// Marks the variable's diagonal block, or a block below it, as changed.
  void touch(std::uint32_t variable);

  [[nodiscard]] std::size_t variables() const { return position_.size(); }
  /// Position of a variable in the order of elimination.
  [[nodiscard]] std::uint32_t position(std::uint32_t variable) const { return position_[variable]; }
  [[nodiscard]] std::uint32_t variable_at(std::uint32_t position) const { return variable_at_[position]; }

  /// \param load called as load(variable, add) for every changed column: calls add(row, block) for the
  ///        variable's diagonal block, and for the blocks whose row comes later in the order
  /// \returns false if the matrix is not positive definite; call analyze() again then
  template <class Load>
  [[nodiscard]] bool refactorize(Load&& load) {
    for (const std::uint32_t s : changed_fronts()) {
      begin(s);
      Front& front = fronts_[s];
      for (std::uint32_t p = front.first; p < front.end; ++p) {
        load(variable_at_[p], [&](std::uint32_t row, const Matrix6d& block) { add(front, p, row, block); });
      }
      if (!finish(s)) return false;
    }
    return true;
  }

  /// Solves for a right-hand side with few non-zero blocks.
  /// \param nonzero positions of the non-zero blocks of x
  /// \param tolerance the solution is not continued down the elimination tree where its elements, times
  ///        sqrt_diagonal(), are below this
  /// \param x six values per position: the right-hand side, then the solution
  /// \param visited the positions for which the solution was computed
  void solve(const std::vector<std::uint32_t>& nonzero, double tolerance, std::vector<double>& x,
             std::vector<std::uint32_t>& visited);

  /// Square root of element k of the matrix's diagonal at a position.
  [[nodiscard]] double sqrt_diagonal(std::uint32_t position, int k) const {
    return sqrt_diagonals_[6 * std::size_t{position} + static_cast<std::size_t>(k)];
  }

  /// Operations of one complete factorisation.
  [[nodiscard]] double flops() const;
  /// Operations of all calls of refactorize() since analyze().
  [[nodiscard]] double flops_spent() const { return flops_spent_; }

 private:
  struct Front {
    std::uint32_t first = 0, end = 0;     ///< Positions of its columns
    int parent = -1;                      ///< Front that contains the first row below
    std::vector<std::uint32_t> rows;      ///< Positions below its columns, ascending
    std::vector<std::uint32_t> children;  ///< Fronts
    std::vector<double> l, u;
    bool changed = true;

    [[nodiscard]] int width() const { return 6 * static_cast<int>(end - first); }
    [[nodiscard]] int below() const { return 6 * static_cast<int>(rows.size()); }
    [[nodiscard]] double flops() const;
  };

  void add_row(std::uint32_t front, std::uint32_t position);
  void mark(std::uint32_t front);
  [[nodiscard]] std::vector<std::uint32_t> changed_fronts();
  void begin(std::uint32_t s);
  void add(Front& front, std::uint32_t column, std::uint32_t row, const Matrix6d& block);
  [[nodiscard]] bool finish(std::uint32_t s);

  std::vector<std::uint32_t> position_, variable_at_;
  std::vector<Front> fronts_;
  std::vector<std::uint32_t> owner_;         ///< By position: its front
  std::vector<std::uint32_t> changed_;       ///< Fronts to factorise again, without those above them
  std::vector<std::uint32_t> index_;         ///< By position: block row in the current front
  std::vector<std::uint32_t> relative_;      ///< Workspace
  std::vector<double> diagonal_, gathered_;  ///< Workspace
  std::vector<char> on_path_;                ///< Workspace, by front
  std::size_t first_appended_ = 0;           ///< Front; the fronts before it are from the analysis
  std::vector<double> sqrt_diagonals_;  ///< Six values per position: square roots of the matrix's diagonal
  double flops_spent_ = 0.0;
};

}  // namespace loopwise::detail
