// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/observability.hpp>

#include <algorithm>

#include <Eigen/Eigenvalues>

namespace loopwise {
namespace {

template <class Matrix>
double smallest_eigenvalue(const Matrix& matrix) {
  const double value = Eigen::SelfAdjointEigenSolver<Matrix>(matrix, Eigen::EigenvaluesOnly).eigenvalues()[0];
  return std::max(0.0, value);  // rounding may put a zero eigenvalue just below 0
}

}  // namespace

Matrix6d observability_matrix(const PointCloud& cloud) {
  Matrix6d A = Matrix6d::Zero();
  if (!cloud.has_normals()) return A;
  Vector6d h;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const Eigen::Vector3d n = cloud.normals[i].cast<double>();
    h.head<3>() = cloud.points[i].cast<double>().cross(n);
    h.tail<3>() = n;
    A.noalias() += h * h.transpose();
  }
  return A;
}

Observability observability(const PointCloud& cloud) {
  Observability out;
  if (!cloud.has_normals()) return out;
  const Matrix6d A = observability_matrix(cloud);
  const Eigen::Matrix3d normals = A.bottomRightCorner<3, 3>() / static_cast<double>(cloud.size());
  out.min_eigenvalue = smallest_eigenvalue(A);
  out.min_eigenvalue_lamp = smallest_eigenvalue(normals);
  return out;
}

}  // namespace loopwise
