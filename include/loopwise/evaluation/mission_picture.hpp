// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// A mission from above as an SVG: each robot's path by odometry (dashed), in truth if known (solid), by a
/// reference (dotted), beacons (triangles), nodes with priors (squares), and in grey the path out of range.
/// North (y) is up.
[[nodiscard]] LOOPWISE_EXPORT std::string mission_picture_svg(const Mission& mission);

}  // namespace loopwise
