// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Rigid motions as text.
#pragma once

#include <string>

#include <Eigen/Geometry>

#include <loopwise/registration/cloud_origins.hpp>

namespace loopwise::cli {

/// The four rows of the matrix, in columns.
[[nodiscard]] std::string matrix_rows(const Eigen::Isometry3d& T, int decimals);

/// A point in whole metres.
[[nodiscard]] std::string point_text(const Eigen::Vector3d& p);

/// The pose of two clouds in the coordinates of their files and, if these are far from zero, about the
/// origins.
[[nodiscard]] std::string pose_text(const Eigen::Isometry3d& T_files, const Eigen::Isometry3d& T_origins,
                                    const CloudOrigins& origins);

}  // namespace loopwise::cli
