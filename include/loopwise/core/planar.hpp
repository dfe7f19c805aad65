// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Poses in the plane z = 0 as poses of SE(3). Of [translation, rotation] they have x, y and the rotation
/// about z. Products, inverses, Exp and Log of planar poses are planar to the last bit.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/se3.hpp>

namespace loopwise::planar {

/// Coordinates of a tangent vector within the plane: x, y, rotation about z.
inline constexpr int kWithin[3] = {0, 1, 5};
/// The other coordinates: z, rotation about x and about y.
inline constexpr int kAcross[3] = {2, 3, 4};

/// The pose at x, y with the rotation `theta` about z.
[[nodiscard]] inline Eigen::Isometry3d pose(double x, double y, double theta) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  const double c = std::cos(theta), s = std::sin(theta);
  T.linear().topLeftCorner<2, 2>() << c, -s, s, c;
  T.translation() << x, y, 0.0;
  return T;
}

/// Rotation about z, rad, in [−π, π].
[[nodiscard]] inline double heading(const Eigen::Isometry3d& T) {
  return std::atan2(T.linear()(1, 0), T.linear()(0, 0));
}

/// Whether z, roll and pitch are exactly 0.
[[nodiscard]] inline bool is_pose(const Eigen::Isometry3d& T) {
  const auto R = T.linear();
  return R(2, 0) == 0.0 && R(2, 1) == 0.0 && R(0, 2) == 0.0 && R(1, 2) == 0.0 && R(2, 2) == 1.0 &&
         T.translation().z() == 0.0;
}

/// The pose with z, roll and pitch set to 0; a planar pose is unchanged.
[[nodiscard]] inline Eigen::Isometry3d flattened(const Eigen::Isometry3d& T) {
  return is_pose(T) ? T : pose(T.translation().x(), T.translation().y(), heading(T));
}

/// Whether the coordinates within the plane have no coupling to the others.
[[nodiscard]] inline bool is_information(const Matrix6d& information) {
  for (const int w : kWithin) {
    for (const int a : kAcross) {
      if (information(w, a) != 0.0 || information(a, w) != 0.0) return false;
    }
  }
  return true;
}

/// Rows and columns of x, y and the rotation about z.
[[nodiscard]] inline Eigen::Matrix3d block(const Matrix6d& m) {
  Eigen::Matrix3d out;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out(i, j) = m(kWithin[i], kWithin[j]);
  }
  return out;
}

/// Converts information on x, y and the rotation about z to that of a pose of SE(3). z gets the mean
/// information of x and y, and rotations about x and y get that of the rotation about z. No result depends on
/// these values; they only have a similar size.
[[nodiscard]] inline Matrix6d information(const Eigen::Matrix3d& m) {
  Matrix6d out = Matrix6d::Zero();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out(kWithin[i], kWithin[j]) = m(i, j);
  }
  out(2, 2) = 0.5 * m(0, 0) + 0.5 * m(1, 1);
  out(3, 3) = out(4, 4) = m(2, 2);
  return out;
}

/// Trace over x, y and the rotation about z.
[[nodiscard]] inline double trace(const Matrix6d& m) {
  return m(0, 0) + m(1, 1) + m(5, 5);
}

}  // namespace loopwise::planar
