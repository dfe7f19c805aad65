// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/cloud_origins.hpp>

namespace loopwise {

Eigen::Isometry3d CloudOrigins::pose_from(const CloudOrigins& other, const Eigen::Isometry3d& pose) const {
  return Eigen::Translation3d(other.target - target) * pose * Eigen::Translation3d(source - other.source);
}

Matrix6d CloudOrigins::covariance_from(const CloudOrigins& other, const Matrix6d& covariance) const {
  const Matrix6d adjoint = se3::adjoint(Eigen::Isometry3d(Eigen::Translation3d(other.source - source)));
  return adjoint * covariance * adjoint.transpose();
}

CloudOrigins origins_to_report(const CloudOrigins& of_clouds) {
  constexpr double kSameCoordinates_m = 1000.0;
  const bool shared = (of_clouds.target - of_clouds.source).norm() < kSameCoordinates_m;
  return shared ? CloudOrigins{of_clouds.target, of_clouds.target} : of_clouds;
}

PointCloud transformed(const PointCloud& cloud, const Eigen::Isometry3d& T, const Eigen::Vector3d& origin) {
  PointCloud out = cloud;
  out.origin = origin;
  for (Eigen::Vector3f& p : out.points) p = (T * p.cast<double>()).cast<float>();
  for (Eigen::Vector3f& n : out.normals) n = (T.linear() * n.cast<double>()).cast<float>();
  return out;
}

}  // namespace loopwise
