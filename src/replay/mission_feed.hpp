// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include <loopwise/engine/events.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/options.hpp>

namespace loopwise {

/// A node of a mission as it arrives at the base station, with all that comes with it.
struct Arrival {
  double time_s = 0.0;                 ///< Mission time.
  KeyFrame frame;                      ///< Without its cloud. Factors to nodes that have arrived.
  std::vector<BeaconDrop> drops;       ///< Beacons that were dropped there.
  std::vector<RadioReading> readings;  ///< Heard there.
  /// Pairs of another place recognition with an older node, see ReplayOptions::candidates. To be proposed
  /// before the node comes, so that what was recognised counts.
  std::vector<LoopCandidate> candidates;
};

/// All nodes of a mission in the order of (time, key), with the odometry of replay_edges(). Beacons and radio
/// only if the method asks for them.
[[nodiscard]] std::vector<Arrival> mission_feed(const Mission& mission, const ReplayOptions& options);

/// The decisions that the options name. \throws InputError on a node that the mission does not have; what
/// read_decisions() throws
[[nodiscard]] std::vector<ClosureDecision> decisions_of(const Mission& mission, const ReplayOptions& options);

/// Reports accepted pairs that the graph has no closure between.
void report_missing(const std::vector<ClosureDecision>& decisions, const PoseGraph& graph,
                    Problems& problems);

/// Poses by odometry and full priors alone, in the order of the arrivals.
[[nodiscard]] std::vector<Eigen::Isometry3d> odometry_of(const std::vector<Arrival>& feed,
                                                         const Robots& robots);

}  // namespace loopwise
