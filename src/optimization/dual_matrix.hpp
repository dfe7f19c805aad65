// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Core>

#include "chordal_problem.hpp"
#include "linalg/block_cholesky.hpp"

namespace loopwise::detail {

/// S = Q − Λ at a critical point of the chordal cost. Eigenvalues are those of S̄, the Schur complement over
/// the rotations, with positions eliminated. For any poses Y, 2·cost(Y) = tr Λ + tr(Y S Yᵀ), and tr(Y S Yᵀ) ≥
/// 3n·λ_min(S̄).
class DualMatrix {
 public:
  /// Analyses the matrix once for all critical points of the problem.
  explicit DualMatrix(const ChordalProblem& problem);

  /// Selects the critical point that later calls refer to.
  void set(const LiftedPoses& X);

  [[nodiscard]] double trace_of_multipliers() const { return trace_; }
  /// Bound on the rounding error of tr(Y S Yᵀ), i.e. the error of 2·cost that a proof does not cover apart
  /// from its shift. Every pose adds a share of its diagonal of S: of the rotational element times 3, and of
  /// the translational element times the squared distance to the held position. Valid for Y whose positions
  /// are as far apart as those of the critical point.
  [[nodiscard]] double rounding() const { return rounding_; }
  /// The largest share of one pose in rounding().
  [[nodiscard]] double largest_rounding() const { return largest_rounding_; }
  /// −spectral_bound() is a lower bound on the eigenvalues of S̄.
  [[nodiscard]] double spectral_bound() const;

  /// Whether S̄ + shift·I, plus the bound on rounding, has a Cholesky factor. If so, λ_min(S̄) > −shift −
  /// that bound.
  [[nodiscard]] bool positive_with(double shift);

  /// The smallest eigenvalue of S̄ and its eigenvector of unit length, extended to the positions that
  /// minimise vᵀSv: 4 entries per pose. Computed by Lanczos' method on (S̄ + shift·I)⁻¹. \pre the last call
  /// was positive_with(shift), and it returned true
  struct Eigenpair {
    double value = 0.0;
    Eigen::VectorXd vector;
    bool converged = false;
  };
  [[nodiscard]] Eigenpair smallest_eigenpair(double shift) const;

 private:
  void hold_places(const LiftedPoses& X);
  [[nodiscard]] Eigen::VectorXd solve(const Eigen::VectorXd& rotations) const;

  const ChordalProblem& problem_;
  BlockCholesky cholesky_;
  std::vector<Eigen::Matrix3d> multipliers_;
  std::vector<std::size_t> held_;  // the pose of each part whose position is held at 0
  double trace_ = 0.0;
  double rounding_ = 0.0;
  double largest_rounding_ = 0.0;
};

}  // namespace loopwise::detail
