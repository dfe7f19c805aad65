// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Relative poses of clouds with coordinates far from zero. The pose of two such clouds in their own
/// coordinates has translations of thousands of kilometres, which amplify errors of the rotation; about a
/// point near the clouds, pose and covariance are meaningful.
#pragma once

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// The points, in the coordinates of each cloud, that a relative pose T_target_source refers to: it maps
/// p − source to q − target.
struct CloudOrigins {
  Eigen::Vector3d target = Eigen::Vector3d::Zero();  ///< In the coordinates of the target, m.
  Eigen::Vector3d source = Eigen::Vector3d::Zero();  ///< In the coordinates of the source, m.

  /// Whether the pose refers to the coordinates themselves.
  [[nodiscard]] bool zero() const { return target.isZero(0.0) && source.isZero(0.0); }

  /// Converts a pose that refers to other points to these points; it maps the same points to each other.
  [[nodiscard]] LOOPWISE_EXPORT Eigen::Isometry3d pose_from(const CloudOrigins& other,
                                                            const Eigen::Isometry3d& pose) const;
  /// Converts the covariance of that pose; both are of right perturbations.
  [[nodiscard]] LOOPWISE_EXPORT Matrix6d covariance_from(const CloudOrigins& other,
                                                         const Matrix6d& covariance) const;
};

/// The points that a reported pose of two clouds should refer to. If both clouds have the same coordinates,
/// i.e. their origins are within a kilometre of each other, this is one common point, so that the pose is the
/// difference of the two; otherwise it is the origin of each.
[[nodiscard]] LOOPWISE_EXPORT CloudOrigins origins_to_report(const CloudOrigins& of_clouds);

/// A cloud with points and normals moved by T, relative to another origin.
[[nodiscard]] LOOPWISE_EXPORT PointCloud transformed(const PointCloud& cloud, const Eigen::Isometry3d& T,
                                                     const Eigen::Vector3d& origin);

}  // namespace loopwise
