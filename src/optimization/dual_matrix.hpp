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
  /// Analyses the matrix, which serves every critical point of the problem.
  explicit DualMatrix(const ChordalProblem& problem);

  /// Of this critical point from now on.
  void set(const LiftedPoses& X);

  [[nodiscard]] double trace_of_multipliers() const { return trace_; }
  /// What rounding may take from tr(Y S Yᵀ), so the error of 2·cost that a proof leaves open besides its
  /// shift: a share of the diagonal of S at each pose, times 3 at the rotation and times the squared distance
  /// to the place that is held at the place. For Y whose places are as far apart as those of the critical
  /// point.
  [[nodiscard]] double rounding() const { return rounding_; }
  /// The largest such share of one pose.
  [[nodiscard]] double largest_rounding() const { return largest_rounding_; }
  /// No eigenvalue of S̄ lies as far below 0.
  [[nodiscard]] double spectral_bound() const;

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
  void hold_places(const LiftedPoses& X);
  [[nodiscard]] Eigen::VectorXd solve(const Eigen::VectorXd& rotations) const;

  const ChordalProblem& problem_;
  BlockCholesky cholesky_;
  std::vector<Eigen::Matrix3d> multipliers_;
  std::vector<std::size_t> held_;  // the pose of each part whose place is held at 0
  double trace_ = 0.0;
  double rounding_ = 0.0;
  double largest_rounding_ = 0.0;
};

}  // namespace loopwise::detail
