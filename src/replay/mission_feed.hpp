// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include <loopwise/engine/events.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/options.hpp>

namespace loopwise {

/// A node of a mission as it arrives at the base station, with all its data.
struct Arrival {
  double time_s = 0.0;                 ///< Mission time.
  KeyFrame frame;                      ///< Without its cloud. Factors to nodes that have arrived.
  std::vector<BeaconDrop> drops;       ///< Beacons that were dropped there.
  std::vector<RadioReading> readings;  ///< Heard there.
  /// Pairs with an older node from another place recognition, see ReplayOptions::candidates. They are
  /// proposed before the node, so that their recognition is not lost to a candidate by proximity.
  std::vector<LoopCandidate> candidates;
};

/// All nodes of a mission in the order of (time, key), with the odometry of replay_edges(). Beacons and radio
/// readings are included only if the method uses them.
[[nodiscard]] std::vector<Arrival> mission_feed(const Mission& mission, const ReplayOptions& options);

/// The decisions in the file that the options name. \throws InputError on a node that is not in the mission;
/// the exceptions of read_decisions()
[[nodiscard]] std::vector<ClosureDecision> decisions_of(const Mission& mission, const ReplayOptions& options);

/// Reports accepted pairs without a closure in the graph.
void report_missing(const std::vector<ClosureDecision>& decisions, const PoseGraph& graph,
                    Problems& problems);

/// Poses by odometry and full priors alone, in the order of the arrivals.
[[nodiscard]] std::vector<Eigen::Isometry3d> odometry_of(const std::vector<Arrival>& feed,
                                                         const Robots& robots);

}  // namespace loopwise
