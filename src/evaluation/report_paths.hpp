// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The robots' paths of a run, and the names of runs.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// A robot's part of a run. The vectors are parallel to `keys`, or empty if unknown.
struct RobotPath {
  std::string name;
  std::vector<Key> keys;
  std::vector<std::int64_t> stamps_ns;
  std::vector<Eigen::Isometry3d> odometry;
};

/// The trajectories have names of robots and stamps, the graph has keys: the file of a robot is the one with
/// the positions of the next keys in order. Keys whose positions are in no file belong to the robot of their
/// character.
[[nodiscard]] std::vector<RobotPath> robot_paths(const std::filesystem::path& folder, const PoseGraph& graph);

/// The shortest ends of the paths that are different: "a/run" and "b/run" keep both parts.
[[nodiscard]] std::vector<std::string> labels_of(const std::vector<std::filesystem::path>& folders);

}  // namespace loopwise
