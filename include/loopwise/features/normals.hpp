// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Surface normals: for each point the direction of least spread of its `neighbours` nearest points,
/// including itself, of unit length and oriented towards the sensor at the origin. If that direction is
/// undefined (fewer than three points, all equal, or on one line) the normal is zero. A zero normal means
/// "unknown" everywhere. `tree` holds `points`. \throws OptionError unless neighbours >= 3.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Eigen::Vector3f> estimate_normals(
    const std::vector<Eigen::Vector3f>& points, const KdTree& tree, int neighbours);

}  // namespace loopwise
