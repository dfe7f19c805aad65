// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/point_cloud.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Surface normals in the frame of the points: for each point the direction of least spread of its nearest
/// points, of unit length and oriented towards the sensor. If that direction is undefined (fewer than three
/// points, all equal, or on one line) or the point is not finite, the normal is zero. A zero normal means
/// "unknown" everywhere. The direction is the eigenvector of the smallest eigenvalue of the points'
/// covariance (Hoppe et al., Surface reconstruction from unorganized points, SIGGRAPH 1992).
/// \param points read in place
/// \param tree of the same points
/// \param neighbours number of nearest points, including the point itself
/// \param sensor position of the sensor in the frame of the points, m
/// \throws OptionError unless neighbours >= 3; InputError if the tree is that of another cloud
[[nodiscard]] LOOPWISE_EXPORT std::vector<Eigen::Vector3f> estimate_normals(
    PointView points, const KdTree& tree, int neighbours = 10,
    const Eigen::Vector3d& sensor = Eigen::Vector3d::Zero());

namespace detail {

/// \throws InputError naming the function `what` unless the tree was built from as many points
LOOPWISE_EXPORT void check_tree(const char* what, const KdTree& tree, PointView points);

}  // namespace detail

}  // namespace loopwise
