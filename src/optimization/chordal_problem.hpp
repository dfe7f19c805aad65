// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/stop_token.hpp>

#include "linalg/block_cholesky.hpp"

namespace loopwise::detail {

/// One term κ‖R_j − R_i R̃‖² + τ‖t_j − t_i − R_i t̃‖² of the isotropic chordal cost.
struct ChordalTerm {
  std::uint32_t from = 0;
  std::uint32_t to = 0;
  Eigen::Matrix4d measured = Eigen::Matrix4d::Identity();  ///< [R̃ t̃; 0 1]
  double kappa = 0.0;
  double tau = 0.0;
};

/// Poses side by side, [R_0 t_0 R_1 t_1 …]: p×4n. p = 3 for poses; more rows belong to the relaxation of rank
/// p, where RᵀR = I still holds for each p×3 block.
using LiftedPoses = Eigen::MatrixXd;

/// ½ tr(X Q Xᵀ) = ½ Σ κ‖R_j − R_i R̃‖² + τ‖t_j − t_i − R_i t̃‖² over the poses of one component. Q has blocks
/// of 4×4: with T̃ the measurement and W = diag(κ, κ, κ, τ) a term is tr (P_j − P_i T̃) W (P_j − P_i T̃)ᵀ.
class ChordalProblem {
 public:
  ChordalProblem(std::size_t poses, std::vector<ChordalTerm> terms);

  [[nodiscard]] std::size_t poses() const { return poses_; }
  [[nodiscard]] const std::vector<ChordalTerm>& terms() const { return terms_; }
  /// The pairs (from, to) of all terms.
  [[nodiscard]] std::vector<BlockCholesky::Pair> pairs() const;
  /// Mean of the rotational part of Q's diagonal, by pose.
  [[nodiscard]] const std::vector<double>& scale() const { return scale_; }
  /// Translational element of Q's diagonal, by pose: the sum of its terms' τ.
  [[nodiscard]] double place_weight(std::size_t pose) const { return diagonal_[pose](3, 3); }
  /// Part of each pose, numbered from 0. Terms with τ > 0 join poses to parts; no term depends on a common
  /// translation of a part.
  [[nodiscard]] const std::vector<std::uint32_t>& parts() const { return parts_; }

  [[nodiscard]] double cost(const LiftedPoses& X) const;
  /// Whether every residual is zero up to rounding, i.e. below 1e-10 of the lengths whose difference it is.
  /// Its information does not matter.
  [[nodiscard]] bool negligible(const LiftedPoses& X) const;
  /// X Q
  [[nodiscard]] LiftedPoses gradient(const LiftedPoses& X) const;
  /// Λ, by pose: the symmetric part of R_iᵀ (XQ)_i.
  [[nodiscard]] std::vector<Eigen::Matrix3d> multipliers(const LiftedPoses& X,
                                                         const LiftedPoses& gradient) const;

  /// Visits the blocks of S = Q − Λ: `diagonal(i, block)` for each pose, then `between(k, block)` for each
  /// term k, whose block is at (from, to).
  template <class Diagonal, class Between>
  void dual_blocks(const std::vector<Eigen::Matrix3d>& multipliers, Diagonal&& diagonal,
                   Between&& between) const {
    for (std::size_t i = 0; i < poses_; ++i) {
      Eigen::Matrix4d block = diagonal_[i];
      block.topLeftCorner<3, 3>() -= multipliers[i];
      diagonal(i, block);
    }
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      const ChordalTerm& term = terms_[k];
      Eigen::Matrix4d block = -term.kappa * term.measured;
      block.col(3) = -term.tau * term.measured.col(3);
      between(k, block);
    }
  }

 private:
  std::size_t poses_;
  std::vector<ChordalTerm> terms_;
  std::vector<Eigen::Matrix4d> diagonal_;  // of Q
  std::vector<double> scale_;
  std::vector<std::uint32_t> parts_;
};

/// The result of a descent.
struct CriticalPoint {
  LiftedPoses X;
  double cost = 0.0;
  double gradient = 0.0;  ///< Largest element of the Riemannian gradient.
  int steps = 0;
  bool converged = false;  ///< The gradient is zero up to rounding.
};

/// Damped Newton steps on the product of Stiefel manifolds and positions, with pose 0 fixed, until the
/// gradient no longer falls. The cost does not rise. \throws Error if a factor would be too large
[[nodiscard]] CriticalPoint descend(const ChordalProblem& problem, LiftedPoses X, int max_steps,
                                    const StopToken& stop);

/// Replaces each p×3 rotation by the nearest matrix with orthonormal columns.
void orthonormalize(LiftedPoses& X);

}  // namespace loopwise::detail
