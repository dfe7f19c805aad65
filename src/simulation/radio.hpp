// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <loopwise/core/thread_pool.hpp>
#include <loopwise/simulation/ray_caster.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "planner.hpp"

namespace loopwise::simulation_detail {

/// The nodes of a robot and their times, in s since the start of the mission.
struct Drive {
  std::vector<Waypoint> waypoints;
  std::vector<double> time_s;
};

struct Drop {
  std::size_t robot;
  std::size_t node;  ///< Number among the robot's nodes.
};

/// Beacon drops of all robots in the order of time. A robot drops a beacon where the paths to the gate and to
/// all beacons are too long. A drop takes time, so it delays later nodes of that robot.
[[nodiscard]] std::vector<Drop> drop_beacons(const RouteGraph& routes, const Distances& ways,
                                             std::vector<Drive>& team, std::uint64_t seed);

/// Windows in which a robot is beyond the reach of the network or its link is down.
[[nodiscard]] std::vector<CommunicationGap> communication_gaps(const RouteGraph& routes,
                                                               const Distances& ways,
                                                               const std::vector<Drive>& team,
                                                               const std::vector<Drop>& drops,
                                                               std::uint64_t seed);

/// One receiver's reading of a beacon at a node; NaN if it was missed.
struct Reception {
  std::size_t robot;
  std::size_t node;
  std::size_t drop;
  std::vector<double> receive_dbm;
  double distance_m;
  int walls;
};

/// Readings of each beacon by all robots after its drop, by robot, node and beacon. A reading that all
/// receivers missed is left out.
[[nodiscard]] std::vector<Reception> receptions_of(const RayCaster& caster, WorldKind kind,
                                                   const std::vector<Drive>& team,
                                                   const std::vector<Drop>& drops, std::uint64_t seed,
                                                   ThreadPool& pool);

/// Position of the beacon of a drop.
[[nodiscard]] Eigen::Vector3d beacon_position(const std::vector<Drive>& team, const Drop& drop);

}  // namespace loopwise::simulation_detail
