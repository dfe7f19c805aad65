// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The robots' paths of a run, and what runs are called.
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

/// The trajectories name robots and hold stamps, the graph holds keys: a robot's file is the one that goes
/// through the positions of the next keys in order. Keys that no file goes through belong to the robot of
/// their character.
[[nodiscard]] std::vector<RobotPath> robot_paths(const std::filesystem::path& folder, const PoseGraph& graph);

/// The shortest tails of the paths that differ: "a/run" and "b/run" keep both words.
[[nodiscard]] std::vector<std::string> labels_of(const std::vector<std::filesystem::path>& folders);

}  // namespace loopwise
