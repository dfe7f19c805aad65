// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include <Eigen/Geometry>

#include "side.hpp"

namespace loopwise {

/// Poses T_target_source far from `found` at which the surfaces may fit as well as at `found`, most promising
/// first. They result from the symmetries of a room and the periods of a hall. Their rotations relative to
/// `found` are turns about the vertical and half turns about a level axis that align the surface directions
/// of both sides, by at most `max_turn_rad`. Their translations are those that most pairs of parallel surface
/// points support, at most `peaks` for each turn, within 24 m and 6 m of height. All poses are `allowed`.
[[nodiscard]] std::vector<Eigen::Isometry3d> find_rivals(
    const Side& source, const Side& target, const Eigen::Isometry3d& found, double max_turn_rad,
    std::size_t peaks, const std::function<bool(const Eigen::Isometry3d&)>& allowed);

}  // namespace loopwise
