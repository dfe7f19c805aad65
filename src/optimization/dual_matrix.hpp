// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Core>

#include "block_cholesky.hpp"
#include "chordal_problem.hpp"

namespace loopwise::detail {

/// S = Q − Λ at a critical point of the chordal cost, with the places eliminated where eigenvalues are meant:
/// S̄, the Schur complement of the rotations. For any poses Y, 2·cost(Y) = tr Λ + tr(Y S Yᵀ), and
/// tr(Y S Yᵀ) ≥ 3n·λ_min(S̄).
class DualMatrix {
 public:
  DualMatrix(const ChordalProblem& problem, std::vector<Eigen::Matrix3d> multipliers);

  [[nodiscard]] double trace_of_multipliers() const { return trace_; }
  /// What rounding may take from the diagonal of S, by pose, times 3 and summed: the error of 2·cost that a
  /// proof leaves open besides its shift.
  [[nodiscard]] double rounding() const { return rounding_; }

  /// Whether S̄ + shift·I, with what rounding may take, has a Cholesky factor: then λ_min(S̄) > −shift − that.
  [[nodiscard]] bool positive_with(double shift);

  /// The smallest eigenvalue of S̄ and its eigenvector of unit length, continued to the places so that it
  /// minimises vᵀSv: 4 entries a pose. By Lanczos' method on (S̄ + shift·I)⁻¹. \pre positive_with(shift) was
  /// the last call and held
  struct Eigenpair {
    double value = 0.0;
    Eigen::VectorXd vector;
    bool converged = false;
  };
  [[nodiscard]] Eigenpair smallest_eigenpair(double shift) const;

 private:
  void add(const BlockCholesky::Slot& slot, const Eigen::Matrix4d& block);
  [[nodiscard]] Eigen::VectorXd solve(const Eigen::VectorXd& rotations) const;

  const ChordalProblem& problem_;
  std::vector<Eigen::Matrix3d> multipliers_;
  BlockCholesky cholesky_;
  double trace_ = 0.0;
  double rounding_ = 0.0;
};

}  // namespace loopwise::detail
