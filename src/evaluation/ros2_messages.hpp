// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The ROS 2 messages that show a run: their CDR bytes (little-endian, XCDR1) and definitions.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/io/trajectory.hpp>

namespace loopwise::ros2 {

/// Of std_msgs/Header.
struct Header {
  std::int64_t stamp_ns = 0;
  std::string frame;
};

/// A type's name in the format of MCAP, and its definition with those of all types within.
struct MessageType {
  const char* name;
  std::string definition;
};

[[nodiscard]] MessageType path_type();
[[nodiscard]] MessageType point_cloud_type();
[[nodiscard]] MessageType marker_array_type();

/// nav_msgs/Path.
[[nodiscard]] std::string path(const Header& header, const std::vector<StampedPose>& poses);

/// sensor_msgs/PointCloud2 with x, y and z as 32-bit floats.
[[nodiscard]] std::string point_cloud(const Header& header, const std::vector<Eigen::Vector3f>& points);

/// A visualization_msgs/Marker of type LINE_LIST.
struct LineList {
  std::string name;  ///< Its namespace.
  std::int32_t id = 0;
  std::vector<Eigen::Vector3d> points;  ///< Two for each line.
  std::array<float, 4> colour{};        ///< Red, green, blue, opacity.
  double width_m = 0.1;
};
/// visualization_msgs/MarkerArray.
[[nodiscard]] std::string marker_array(const Header& header, const std::vector<LineList>& lines);

}  // namespace loopwise::ros2
