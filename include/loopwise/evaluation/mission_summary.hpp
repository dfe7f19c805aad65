// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The contents of a mission in figures, as JSON and as text.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/scan_store.hpp>

namespace loopwise {

/// Points of the scans that could be read.
struct PointCounts {
  std::size_t scans = 0;   ///< Scans that were read.
  std::size_t total = 0;   ///< Points of all of them.
  std::size_t fewest = 0;  ///< Points of the smallest scan.
  std::size_t most = 0;    ///< Points of the largest scan.

  /// Points of a scan in the mean; 0 without scans.
  [[nodiscard]] double mean() const {
    return scans == 0 ? 0.0 : static_cast<double>(total) / static_cast<double>(scans);
  }
};

/// Reads all scans, one at a time. Scans that cannot be read are left out; the store counts them.
[[nodiscard]] LOOPWISE_EXPORT PointCounts count_points(const ScanStore& scans, const StopToken& stop = {},
                                                       const ProgressCallback& progress = {});

/// A robot or a group of landmarks.
struct RobotSummary {
  std::string name;              ///< Of the robot.
  std::size_t nodes = 0;         ///< Number of its nodes.
  double length_m = 0.0;         ///< Length of the path along its nodes, in the order of their keys.
  std::optional<Key> first_key;  ///< Smallest key; empty without nodes.
  std::optional<Key> last_key;   ///< Largest key; empty without nodes.
  bool landmarks = false;        ///< Whether its nodes are landmarks.
};

/// Figures of a mission.
struct MissionSummary {
  MissionKind kind = MissionKind::kMission;  ///< Kind of the source.
  std::string name;                          ///< Of the mission.
  std::vector<RobotSummary> robots;          ///< In the order of the mission.
  std::size_t nodes = 0;                     ///< Nodes of the graph, landmarks included.
  bool planar = false;                       ///< As PoseGraph::planar().
  std::size_t edges = 0;                     ///< Edges of all kinds.
  std::size_t odometry_edges = 0;            ///< Of these, odometry.
  std::size_t sightings = 0;                 ///< Of these, from key frames to landmarks.
  std::size_t priors = 0;                    ///< Priors of the graph.
  std::size_t ranges = 0;                    ///< Measured distances between nodes.
  std::size_t gravity = 0;                   ///< Measured directions of gravity.
  std::size_t components = 0;                ///< Connected components of the graph.
  std::size_t scans = 0;                     ///< Nodes with a scan.
  PointCounts points;                        ///< Of the scans, if they were counted.
  std::size_t ground_truth = 0;              ///< Nodes with a true pose.
  std::size_t reference = 0;                 ///< Nodes with a pose of another program.
  Statistics reference_difference_m;         ///< Between these poses and those of the graph, m.
  std::size_t radio_readings = 0;            ///< Readings of received power.
  std::size_t beacons = 0;                   ///< Dropped radio beacons.
  std::size_t communication_gaps = 0;        ///< Times without contact to a robot.
  double length_m = 0.0;                     ///< Length of all paths.
  double duration_s = 0.0;                   ///< From the first to the last key frame.
  Problems problems;                         ///< Of the mission and of its scans so far.
};

/// Counts the contents of a mission. `points` are those of count_points(); without them the figures of the
/// points are 0.
[[nodiscard]] LOOPWISE_EXPORT MissionSummary summarize_mission(const Mission& mission,
                                                               const PointCounts& points = {});

/// The figures as a JSON object, as `loopwise info` prints them.
[[nodiscard]] LOOPWISE_EXPORT std::string mission_summary_json(const MissionSummary& summary);

/// The figures as text: a table of the robots, and a line for each kind of contents.
[[nodiscard]] LOOPWISE_EXPORT std::string mission_summary_text(const MissionSummary& summary);

}  // namespace loopwise
