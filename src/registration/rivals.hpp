// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <vector>

#include <Eigen/Geometry>

#include "side.hpp"

namespace loopwise {

/// Poses T_target_source far from `found`, turned by `max_turn_rad` against it at most, that are `allowed`
/// and at which the source's surfaces may meet the target's as they do there; most promising first. They are
/// what the symmetries of a room and the periods of a hall make of a pose: turns about the vertical, and half
/// turns about a level axis, that carry the directions of the source's surfaces into those of the target's,
/// each with the translations that most pairs of parallel surface points agree on, within 24 m and 6 m of
/// height.
[[nodiscard]] std::vector<Eigen::Isometry3d> find_rivals(
    const Side& source, const Side& target, const Eigen::Isometry3d& found, double max_turn_rad,
    const std::function<bool(const Eigen::Isometry3d&)>& allowed);

}  // namespace loopwise
