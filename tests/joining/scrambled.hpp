// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Missions whose robots have lost their common frame, and how well it was found again.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Dense>

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

/// Difference of two poses of robot b's frame, at the middle of b's path.
inline FrameError frame_difference(const Mission& mission, std::size_t b, const Eigen::Isometry3d& one,
                                   const Eigen::Isometry3d& other) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double nodes = 0.0;
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.of(node.key) != b) continue;
    middle += node.pose.translation();
    nodes += 1.0;
  }
  middle /= std::max(1.0, nodes);
  return {(one * middle - other * middle).norm(), se3::rotation_angle(other.inverse() * one)};
}

/// Error of the pose of robot b's frame in that of a, at the middle of b's path.
inline FrameError frame_error(const ScrambledMission& scrambled, std::size_t a, std::size_t b,
                              const Eigen::Isometry3d& T_a_b) {
  const Eigen::Isometry3d truth = scrambled.T_own_world[a] * scrambled.T_own_world[b].inverse();
  return frame_difference(scrambled.mission, b, T_a_b, truth);
}

/// Odometry from one key frame of a path to a later one, composed of the edges between; empty if the path is
/// broken. \param next the odometry edge that leaves each key frame
inline std::optional<Edge> composed_odometry(const std::map<Key, Edge>& next, Key from, Key to) {
  std::optional<Edge> all;
  for (auto step = next.find(from); step != next.end(); step = next.find(step->second.to)) {
    const Edge& edge = step->second;
    if (!all) {
      all = edge;
    } else {
      const Matrix6d back = se3::adjoint(edge.T_from_to.inverse());
      const Matrix6d covariance =
          back * all->information.inverse() * back.transpose() + edge.information.inverse();
      all->T_from_to = all->T_from_to * edge.T_from_to;
      all->information = covariance.inverse();
      all->information = 0.5 * (all->information + all->information.transpose()).eval();
      all->to = edge.to;
    }
    if (edge.to == to) return all;
  }
  return std::nullopt;
}

/// Stretches of a mission's paths as robots a, b and so on. Odometry between key frames that are no
/// neighbours on the path is composed. The truth is that of the mission, or its poses if it has none. \param
/// stretches key frames of one robot each, in the order of its path; no key frame is in two of them
inline Mission as_robots(const Mission& mission, const std::vector<std::vector<Key>>& stretches) {
  std::map<Key, Edge> next;
  for (const Edge& edge : mission.graph.edges()) {
    if (edge.kind == EdgeKind::kOdometry) next.emplace(edge.from, edge);
  }
  Mission out = mission;
  out.graph = PoseGraph();
  out.ground_truth.clear();
  out.reference.clear();
  out.gaps.clear();
  out.radio.clear();
  out.beacons.clear();
  std::vector<Robot> robots;
  std::map<Key, ScanStore::Part> scans;
  for (std::size_t s = 0; s < stretches.size(); ++s) {
    const char letter = static_cast<char>('a' + s);
    robots.push_back(robot_of_character(letter, std::string(1, letter)));
    std::optional<Key> previous;
    for (const Key key : stretches[s]) {
      Node node = mission.graph.node(key);
      node.key = make_key(letter, key_index(key));
      out.graph.add_node(node);
      const auto truth = mission.ground_truth.find(key);
      out.ground_truth[node.key] = truth == mission.ground_truth.end() ? node.pose : truth->second;
      if (mission.scans->has(key)) scans[node.key] = {mission.scans, key};
      if (previous) {
        if (std::optional<Edge> edge = composed_odometry(next, *previous, key)) {
          edge->from = make_key(letter, key_index(*previous));
          edge->to = node.key;
          out.graph.add_edge(*edge);
        }
      }
      previous = key;
    }
  }
  out.robots = Robots(robots);
  out.scans = std::make_shared<ScanStore>(std::move(scans));
  return out;
}

/// A mission of one robot cut into pieces of equal length, each a robot of its own.
/// \param shared key frames before and after each cut, which go in turn to the piece before and the piece
/// after it: both pieces then saw the same stretch, in different scans
inline Mission cut(const Mission& mission, std::size_t pieces, std::size_t shared = 0) {
  std::vector<Key> keys = mission.graph.keys();
  std::sort(keys.begin(), keys.end());
  std::vector<std::vector<Key>> stretches(pieces);
  for (std::size_t i = 0; i < keys.size(); ++i) {
    std::size_t piece = std::min(pieces - 1, i * pieces / keys.size());
    for (std::size_t next = 1; next < pieces; ++next) {
      const std::size_t first = (next * keys.size() + pieces - 1) / pieces;
      if (i + shared >= first && i < first + shared) piece = i % 2 == 0 ? next - 1 : next;
    }
    stretches[piece].push_back(keys[i]);
  }
  return as_robots(mission, stretches);
}

}  // namespace loopwise::testing
