// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Reads sensor_msgs/PointCloud2 with fields at any position. Private to io.
#pragma once

#include <string>

#include <loopwise/io/cloud.hpp>

#include "ros_message.hpp"

namespace loopwise::ros1 {

/// Throws the errors of read_point_cloud2() without a look at the points.
void check_point_cloud2(const std::string& name, const Value& message);

/// Reads the points by the offsets, types, strides and byte order of the message. Counts problems as
/// read_cloud(). \throws InputError naming `name` if x, y or z is missing, or a size does not fit the data
[[nodiscard]] CloudFile read_point_cloud2(const std::string& name, const Value& message);

}  // namespace loopwise::ros1
