// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Surface normals: for each point the direction in which its `neighbours` nearest points, itself included,
/// spread least, of unit length and turned towards the sensor at the origin. Where that direction is not
/// defined (fewer than three points, all equal, or on one line) the normal is zero; the zero normal stands
/// for "unknown" everywhere. `tree` holds `points`. \throws OptionError unless neighbours >= 3.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Eigen::Vector3f> estimate_normals(
    const std::vector<Eigen::Vector3f>& points, const KdTree& tree, int neighbours);

}  // namespace loopwise
