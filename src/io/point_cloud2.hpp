// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// sensor_msgs/PointCloud2, wherever its fields stand. Private to io.
#pragma once

#include <string>

#include <loopwise/io/cloud.hpp>

#include "ros_message.hpp"

namespace loopwise::ros1 {

/// Throws what read_point_cloud2() would without looking at the points.
void check_point_cloud2(const std::string& name, const Value& message);

/// The points by the message's own offsets, types, strides and byte order. Flaws are counted as read_cloud()
/// does. \throws InputError naming `name` if there is no x, y and z, or a size does not fit the data.
[[nodiscard]] CloudFile read_point_cloud2(const std::string& name, const Value& message);

}  // namespace loopwise::ros1
