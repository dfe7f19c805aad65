// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Bags of ROS 2 that seeds are made of. Their messages are of ROS 1, which MCAP may hold as well.
#pragma once

#include <string>
#include <vector>

#include "lamp_data.hpp"

namespace loopwise::fuzz {

/// An MCAP file; in chunks compressed by "", "zstd" or "lz4"; "none": without chunks.
[[nodiscard]] std::string mcap(const std::vector<TypedMessage>& messages, const std::string& compression);

/// A database of rosbag2.
[[nodiscard]] std::string db3(const std::vector<TypedMessage>& messages);

/// A database of RTAB-Map: three nodes with scans, a closure, optimised poses.
[[nodiscard]] std::string rtabmap_database();

}  // namespace loopwise::fuzz
