// SPDX-License-Identifier: BSD-3-Clause
#include "information.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise {
namespace {

// Six printed digits leave a semi-definite matrix indefinite by about 1e-6 of its diagonal.
constexpr double kRelativeRounding = 1e-5;
// A diagonal element below this share of the largest is rounding of the decomposition.
constexpr double kNegligible = 1e-15;

using Solver = Eigen::SelfAdjointEigenSolver<Matrix6d>;

Matrix6d with_eigenvalues(const Matrix6d& V, const Vector6d& eigenvalues) {
  const Matrix6d product = V * eigenvalues.cwiseMax(0.0).asDiagonal() * V.transpose();
  return 0.5 * (product + product.transpose());
}

/// Square roots of the diagonal. Elements that are zero are replaced by the largest element.
Vector6d scale_of(const Matrix6d& information) {
  const double largest = information.diagonal().maxCoeff();
  return information.diagonal().unaryExpr(
      [largest](double v) { return std::sqrt(v > 0.0 ? v : std::max(largest, 1.0)); });
}

Matrix6d scaled(const Matrix6d& information, const Vector6d& d) {
  return d.cwiseInverse().asDiagonal() * information * d.cwiseInverse().asDiagonal();
}

Matrix6d clipped_without_scaling(const Matrix6d& information) {
  const double largest = information.cwiseAbs().maxCoeff();
  const Solver solver(information / largest);
  Matrix6d clipped = with_eigenvalues(solver.eigenvectors(), solver.eigenvalues());
  for (int i = 0; i < 6; ++i) {
    if (clipped(i, i) > kNegligible) continue;
    clipped.row(i).setZero();
    clipped.col(i).setZero();
  }
  return largest * clipped;
}

Matrix6d clipped_with_unit_diagonal(const Matrix6d& information) {
  const Vector6d d = scale_of(information);
  const Solver solver(scaled(information, d));
  return with_eigenvalues(d.asDiagonal() * solver.eigenvectors(), solver.eigenvalues());
}

}  // namespace

SoundInformation nearest_information(const Matrix6d& information) {
  if (check_information(information) == nullptr) return {information, InformationFlaw::kSound};
  const Vector6d diagonal = information.diagonal();
  if (diagonal.minCoeff() >= 0.0 && diagonal.maxCoeff() > 0.0) {
    const Matrix6d unit = scaled(information, scale_of(information));
    if (unit.allFinite() &&
        Solver(unit, Eigen::EigenvaluesOnly).eigenvalues().minCoeff() > -kRelativeRounding)
      return {clipped_with_unit_diagonal(information), InformationFlaw::kRounded};
  }
  SoundInformation nearest{clipped_without_scaling(information), InformationFlaw::kIndefinite};
  // Rounding of the decomposition may be large relative to the smallest elements of the diagonal.
  if (check_information(nearest.matrix) != nullptr)
    nearest.matrix = clipped_with_unit_diagonal(nearest.matrix);
  return nearest;
}

Matrix6d moved_information(const Matrix6d& information, const Eigen::Isometry3d& T) {
  const Matrix6d ad = se3::adjoint(T);
  const Matrix6d moved = ad.transpose() * information * ad;
  return nearest_information(0.5 * (moved + moved.transpose())).matrix;
}

}  // namespace loopwise
