// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/place.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>

namespace loopwise {

std::vector<PlaceMatch> PlaceDatabase::query(Key key, std::size_t k, const PlaceFilter& filter) const {
  const auto place = find(key);
  if (!place) throw UnknownKeyError("place " + key_name(key) + " is not in the database");
  return search(*place, k, [&](Key other) { return other != key && (!filter || filter(other)); });
}

Eigen::Matrix3d level_rotation(const Eigen::Isometry3d& T_world_body) {
  // Splits the rotation into a twist about z and a tilt: R = Rz(yaw) · level.
  const Eigen::Quaterniond q(T_world_body.linear());
  const double norm = std::hypot(q.w(), q.z());
  if (norm < 1e-9) return T_world_body.linear();  // upside down: yaw and tilt cannot be separated
  const Eigen::Quaterniond yaw(q.w() / norm, 0.0, 0.0, q.z() / norm);
  return (yaw.conjugate() * q).normalized().toRotationMatrix();
}

PointCloud level_cloud(const PointCloud& body, const Eigen::Isometry3d& T_world_body) {
  const Eigen::Matrix3d R = level_rotation(T_world_body);
  const Eigen::Matrix3f turn = R.cast<float>();
  PointCloud level = body;
  for (Eigen::Vector3f& point : level.points) point = turn * point;
  for (Eigen::Vector3f& normal : level.normals) normal = turn * normal;
  level.origin = R * body.origin;
  return level;
}

PlaceMatch between_bodies(const PlaceMatch& match, const Eigen::Matrix3d& query_rotation,
                          const Eigen::Matrix3d& match_rotation) {
  Eigen::Isometry3d query = Eigen::Isometry3d::Identity(), other = Eigen::Isometry3d::Identity();
  query.linear() = query_rotation;
  other.linear() = match_rotation;
  PlaceMatch out = match;
  out.T_query_match = se3::normalized(query.inverse() * match.T_query_match * other);
  // Moves the perturbation from the level frame to the body frame.
  out.covariance = se3::covariance_of_inverse(other.inverse(), match.covariance);
  return out;
}

}  // namespace loopwise
