// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Missions whose robots have lost their common frame, and how well it was found again.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/place_parts.hpp>
#include <loopwise/replay/read_team.hpp>

namespace loopwise::testing {

/// A mission whose robots stand each in a frame of its own.
struct ScrambledMission {
  Mission mission;
  std::vector<Eigen::Isometry3d> T_own_world;  ///< By robot, as it was moved.
};

/// Turns each robot by a random yaw and moves it by up to 100 m along each axis of the plane; its priors say
/// nothing about the others any more.
inline ScrambledMission scrambled(const Mission& mission, std::uint64_t seed) {
  Rng rng(seed);
  ScrambledMission out;
  std::vector<MissionPart> parts;
  for (std::size_t robot = 0; robot < mission.robots.size(); ++robot) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = Eigen::AngleAxisd(rng.uniform(-3.14159, 3.14159), Eigen::Vector3d::UnitZ()).matrix();
    T.translation() = Eigen::Vector3d(rng.uniform(-100.0, 100.0), rng.uniform(-100.0, 100.0), 0.0);
    out.T_own_world.push_back(T);
    MissionPart part;
    part.robots = {robot};
    part.T_common_part = T;
    part.sigmas = {0.002, 0.002, 0.002, 0.04, 0.04, 0.0004};
    parts.push_back(part);
  }
  out.mission = place_parts(mission, parts, {}, /*move_truth=*/false);
  return out;
}

/// How far a found frame is from the true one.
struct FrameError {
  double translation_m = 0.0;  ///< Mean over the robot's key frames, that of the middle: no lever arm.
  double rotation_rad = 0.0;
};

/// Error of the pose of robot b's frame in that of a, at the middle of b's path.
inline FrameError frame_error(const ScrambledMission& scrambled, std::size_t a, std::size_t b,
                              const Eigen::Isometry3d& T_a_b) {
  const Eigen::Isometry3d truth = scrambled.T_own_world[a] * scrambled.T_own_world[b].inverse();
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double nodes = 0.0;
  for (const Node& node : scrambled.mission.graph.nodes()) {
    if (scrambled.mission.robots.of(node.key) != b) continue;
    middle += node.pose.translation();
    nodes += 1.0;
  }
  middle /= std::max(1.0, nodes);
  return {(T_a_b * middle - truth * middle).norm(), se3::rotation_angle(truth.inverse() * T_a_b)};
}

/// A mission of one robot cut into pieces of equal length, each a robot of its own.
inline Mission cut(const Mission& mission, std::size_t pieces) {
  Mission out = mission;
  std::vector<Key> keys = mission.graph.keys();
  std::sort(keys.begin(), keys.end());
  const auto piece_of = [&](Key key) {
    const auto place =
        static_cast<std::size_t>(std::lower_bound(keys.begin(), keys.end(), key) - keys.begin());
    return std::min(pieces - 1, place * pieces / keys.size());
  };
  const auto renamed = [&](Key key) {
    return make_key(static_cast<char>('a' + piece_of(key)), key_index(key));
  };
  PoseGraph graph;
  std::vector<Robot> robots;
  std::map<Key, ScanStore::Part> scans;
  for (std::size_t p = 0; p < pieces; ++p) {
    const char letter = static_cast<char>('a' + p);
    robots.push_back(robot_of_character(letter, std::string(1, letter)));
  }
  out.ground_truth.clear();
  out.reference.clear();
  for (const Key key : keys) {
    Node node = mission.graph.node(key);
    node.key = renamed(key);
    graph.add_node(node);
    out.ground_truth[node.key] = node.pose;
    if (mission.scans->has(key)) scans[node.key] = {mission.scans, key};
  }
  for (Edge edge : mission.graph.edges()) {
    if (piece_of(edge.from) != piece_of(edge.to) || edge.kind != EdgeKind::kOdometry) continue;
    edge.from = renamed(edge.from);
    edge.to = renamed(edge.to);
    graph.add_edge(edge);
  }
  out.graph = graph;
  out.robots = Robots(robots);
  out.scans = std::make_shared<ScanStore>(std::move(scans));
  return out;
}

}  // namespace loopwise::testing
