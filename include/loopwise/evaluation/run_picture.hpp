// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// A run from above as an SVG: the map's points, each robot's optimised path, the path by odometry alone, the
/// true one if known, and the verified closures, with those that the back end left out in red. North (y) is
/// up. Points are thinned to a few thousand, so that any viewer opens it at once.
[[nodiscard]] LOOPWISE_EXPORT std::string run_picture_svg(const Mission& mission, const ReplayResult& result,
                                                          const PointCloud& map);

}  // namespace loopwise
