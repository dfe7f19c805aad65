// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <loopwise/core/thread_pool.hpp>
#include <loopwise/simulation/ray_caster.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "planner.hpp"

namespace loopwise::simulation_detail {

/// A robot's nodes, and when each was made, s since the mission began.
struct Drive {
  std::vector<Waypoint> waypoints;
  std::vector<double> time_s;
};

struct Drop {
  std::size_t robot;
  std::size_t node;  ///< Among the robot's own.
};

/// When robots leave beacons, in the order of time: where the way to the gate or the nearest beacon gets too
/// long. Dropping takes time: later nodes of that robot are delayed.
[[nodiscard]] std::vector<Drop> drop_beacons(const RouteGraph& routes, const Distances& ways,
                                             std::vector<Drive>& team, std::uint64_t seed);

/// Windows in which a robot is beyond the reach of the network or its link is down.
[[nodiscard]] std::vector<CommunicationGap> communication_gaps(const RouteGraph& routes,
                                                               const Distances& ways,
                                                               const std::vector<Drive>& team,
                                                               const std::vector<Drop>& drops,
                                                               std::uint64_t seed);

/// One receiver's reading of a beacon at a node; NaN if it was missed.
struct Heard {
  std::size_t robot;
  std::size_t node;
  std::size_t drop;
  std::vector<double> receive_dbm;
  double distance_m;
  int walls;
};

/// What every robot hears after each beacon's drop, by robot, node and beacon. Readings that no receiver made
/// are left out.
[[nodiscard]] std::vector<Heard> listen(const RayCaster& caster, WorldKind kind,
                                        const std::vector<Drive>& team, const std::vector<Drop>& drops,
                                        std::uint64_t seed, ThreadPool& pool);

/// Where the beacon of a drop lies.
[[nodiscard]] Eigen::Vector3d beacon_position(const std::vector<Drive>& team, const Drop& drop);

}  // namespace loopwise::simulation_detail
