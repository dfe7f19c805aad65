// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The output of `loopwise info` for a mission, as text and as JSON.
#pragma once

#include <cstddef>
#include <string>

#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise::cli {

/// Points of the scans that were read.
struct PointCounts {
  std::size_t scans = 0, total = 0, fewest = 0, most = 0;
};

/// Sets the figures of robots, graph, scans, truth and radio.
void describe_mission(const Mission& mission, const PointCounts& points, const Problems& problems, Json& json,
                      std::string& text);
/// Adds the drift of odometry, if ground truth is known.
void add_drift(const Mission& mission, Json& json, std::string& text);
/// Adds the topics of the bags and the data taken from each.
void add_topics(const Mission& mission, Json& json, std::string& text);

}  // namespace loopwise::cli
