// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <iosfwd>

#include <loopwise/io/mission.hpp>

namespace loopwise {

/// The mission from above: each robot's odometry, the ground truth where known, beacons, gates (first nodes)
/// and the stretches driven out of range. North (y) is up; a bar shows the scale.
void write_map_svg(std::ostream& out, const Mission& mission);

}  // namespace loopwise
