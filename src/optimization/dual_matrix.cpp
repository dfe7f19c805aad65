// SPDX-License-Identifier: BSD-3-Clause
#include "dual_matrix.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Eigenvalues>

#include <loopwise/core/random.hpp>

namespace loopwise::detail {
namespace {

/// Rounding error of a factorisation relative to the diagonal: tens of units in the last place.
constexpr double kRounding = 1e-14, kPlaceRounding = 1e-14;

}  // namespace

DualMatrix::DualMatrix(const ChordalProblem& problem)
    : problem_(problem), cholesky_(4, Factorization::kAutomatic) {
  cholesky_.analyze(problem.poses(), problem.pairs());
}

void DualMatrix::set(const LiftedPoses& X) {
  multipliers_ = problem_.multipliers(X, problem_.gradient(X));
  hold_places(X);
  trace_ = rounding_ = largest_rounding_ = 0.0;
  for (std::size_t i = 0; i < problem_.poses(); ++i) {
    trace_ += multipliers_[i].trace();
    const auto place = [&](std::size_t pose) { return X.col(4 * static_cast<Eigen::Index>(pose) + 3); };
    const double share = kRounding * 3.0 * problem_.scale()[i] +
                         kPlaceRounding * problem_.place_weight(i) *
                             (place(i) - place(held_[problem_.parts()[i]])).squaredNorm();
    rounding_ += share;
    largest_rounding_ = std::max(largest_rounding_, share);
  }
}

/// Holds the pose of each part that is nearest to its middle: the rounding error grows with the distance from
/// it.
void DualMatrix::hold_places(const LiftedPoses& X) {
  const std::vector<std::uint32_t>& parts = problem_.parts();
  const std::size_t count = *std::max_element(parts.begin(), parts.end()) + std::size_t{1};
  Eigen::MatrixXd middle = Eigen::MatrixXd::Zero(X.rows(), static_cast<Eigen::Index>(count));
  std::vector<double> weight(count, 0.0), nearest(count, std::numeric_limits<double>::infinity());
  for (std::size_t i = 0; i < parts.size(); ++i) {
    middle.col(parts[i]) += X.col(4 * static_cast<Eigen::Index>(i) + 3);
    weight[parts[i]] += 1.0;
  }
  held_.assign(count, 0);
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const double distance =
        (X.col(4 * static_cast<Eigen::Index>(i) + 3) - middle.col(parts[i]) / weight[parts[i]]).squaredNorm();
    if (!(distance < nearest[parts[i]])) continue;
    nearest[parts[i]] = distance;
    held_[parts[i]] = i;
  }
}

double DualMatrix::spectral_bound() const {
  double largest = 0.0;  // S̄ + Λ is semi-definite
  for (const Eigen::Matrix3d& m : multipliers_) largest = std::max(largest, m.norm());
  return largest;
}

bool DualMatrix::positive_with(double shift) {
  BlockMatrix& matrix = cholesky_.matrix();
  matrix.set_zero();
  problem_.dual_blocks(
      multipliers_,
      [&](std::size_t i, Eigen::Matrix4d block) {
        block.diagonal().head<3>().array() += shift + kRounding * problem_.scale()[i];
        block(3, 3) *= 1.0 + kPlaceRounding;
        matrix.add(matrix.diagonal_slot(i), block);
      },
      [&](std::size_t k, const Eigen::Matrix4d& block) { matrix.add(matrix.pair_slot(k), block); });
  // A common translation of all positions costs nothing, so holding one of them at 0 does not change the
  // minimum.
  Eigen::VectorXd diagonal = matrix.diagonal();
  for (const std::size_t pose : held_) {
    double& place = diagonal[4 * static_cast<Eigen::Index>(pose) + 3];
    place = place > 0.0 ? 2.0 * place : 1.0;
  }
  matrix.set_diagonal(diagonal);
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
  Eigen::MatrixXd basis(n, std::min(most, 16));  // grows: large graphs need few vectors
  Eigen::VectorXd alpha(most), beta(most);
  Eigenpair out;
  basis.col(0) = v.normalized();
  for (int k = 0; k < most; ++k) {
    Eigen::VectorXd w = solve(basis.col(k));
    rotations_alone(w);
    alpha[k] = w.dot(basis.col(k));
    // Twice: after one pass, vectors of close eigenvalues are not orthogonal enough.
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
    if (k + 1 == basis.cols()) basis.conservativeResize(n, std::min<Eigen::Index>(most, 2 * basis.cols()));
    basis.col(k + 1) = w / beta[k];
  }
  return out;
}

}  // namespace loopwise::detail
