// SPDX-License-Identifier: BSD-3-Clause
#include "dual_matrix.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Eigenvalues>

#include <loopwise/core/random.hpp>

namespace loopwise::detail {
namespace {

/// Rounding of a factorisation in relation to the diagonal: some tens of units in the last place.
constexpr double kRounding = 1e-14;

}  // namespace

DualMatrix::DualMatrix(const ChordalProblem& problem, std::vector<Eigen::Matrix3d> multipliers)
    : problem_(problem), multipliers_(std::move(multipliers)), cholesky_(4, Factorization::kAutomatic) {
  cholesky_.analyze(problem.poses(), problem.pairs());
  for (const Eigen::Matrix3d& m : multipliers_) trace_ += m.trace();
  for (const double scale : problem.scale()) rounding_ += 3.0 * kRounding * scale;
}

void DualMatrix::add(const BlockCholesky::Slot& slot, const Eigen::Matrix4d& block) {
  for (int c = 0; c < 4; ++c) {
    for (int r = 0; r < 4; ++r) {
      cholesky_
          .values()[slot.offset + static_cast<std::size_t>(c) * slot.stride + static_cast<std::size_t>(r)] +=
          slot.transposed ? block(c, r) : block(r, c);
    }
  }
}

bool DualMatrix::positive_with(double shift) {
  cholesky_.set_zero();
  problem_.dual_blocks(
      multipliers_,
      [&](std::size_t i, Eigen::Matrix4d block) {
        block.diagonal().head<3>().array() += shift + kRounding * problem_.scale()[i];
        add(cholesky_.diagonal_slot(i), block);
      },
      [&](std::size_t k, const Eigen::Matrix4d& block) { add(cholesky_.pair_slot(k), block); });
  // A common shift of all places costs nothing: holding one of them at 0 leaves the minimum as it is.
  Eigen::VectorXd diagonal = cholesky_.diagonal();
  for (const std::uint32_t pose : problem_.grounded()) {
    double& place = diagonal[4 * static_cast<Eigen::Index>(pose) + 3];
    place = place > 0.0 ? 2.0 * place : 1.0;
  }
  cholesky_.set_diagonal(diagonal);
  return cholesky_.factorize() && cholesky_.smallest_pivot().first > 0.0;
}

Eigen::VectorXd DualMatrix::solve(const Eigen::VectorXd& rotations) const {
  Eigen::VectorXd x = rotations;
  cholesky_.solve(x);
  return x;
}

DualMatrix::Eigenpair DualMatrix::smallest_eigenpair(double shift) const {
  constexpr int kMaxVectors = 200;
  constexpr double kTolerance = 1e-10;
  const auto n = static_cast<Eigen::Index>(4 * problem_.poses());
  const auto rotations_alone = [](Eigen::VectorXd& v) {
    for (Eigen::Index at = 3; at < v.size(); at += 4) v[at] = 0.0;
  };
  Rng rng(1);
  Eigen::VectorXd v(n);
  for (Eigen::Index i = 0; i < n; ++i) v[i] = rng.normal();
  rotations_alone(v);
  const int most = static_cast<int>(std::min<Eigen::Index>(kMaxVectors, n / 4 * 3));
  Eigen::MatrixXd basis(n, most);
  Eigen::VectorXd alpha(most), beta(most);
  Eigenpair out;
  basis.col(0) = v.normalized();
  for (int k = 0; k < most; ++k) {
    Eigen::VectorXd w = solve(basis.col(k));
    rotations_alone(w);
    alpha[k] = w.dot(basis.col(k));
    // Twice: once leaves the vectors as far from orthogonal as the eigenvalues are close.
    for (int twice = 0; twice < 2; ++twice)
      w -= basis.leftCols(k + 1) * (basis.leftCols(k + 1).transpose() * w);
    beta[k] = w.norm();
    Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> ritz;
    ritz.computeFromTridiagonal(alpha.head(k + 1), beta.head(k));
    const double largest = ritz.eigenvalues()[k];
    const Eigen::VectorXd weights = ritz.eigenvectors().col(k);
    out.converged = beta[k] * std::abs(weights[k]) <= kTolerance * largest;
    if (out.converged || k + 1 == most) {
      out.value = 1.0 / largest - shift;
      out.vector = solve(basis.leftCols(k + 1) * weights) / largest;
      return out;
    }
    basis.col(k + 1) = w / beta[k];
  }
  return out;
}

}  // namespace loopwise::detail
