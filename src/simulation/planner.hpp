// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Where the robots drive: an exploring team over the route graph, then poses along the way.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/simulation/world.hpp>

#include "parameters.hpp"

namespace loopwise::simulation_detail {

/// One passage driven along, from end to end.
struct Leg {
  std::size_t passage;
  bool forward;
};

/// Routes from the gate of `robots` robots that explore together. Each goes on beyond `length_m`, so that
/// whoever cuts it there has enough; most are back at the gate by then.
[[nodiscard]] std::vector<std::vector<Leg>> plan_routes(const RouteGraph& routes, int robots, double length_m,
                                                        std::uint64_t seed);

/// A node's worth of driving.
struct Waypoint {
  Eigen::Isometry3d T_world_body;
  double time_s = 0.0;  ///< Since the robot's start.
  std::size_t passage = 0;
  double along_m = 0.0;  ///< From the passage's `from`.
};

/// Poses every `spacing_m` of the way, at most `count`: the sensor above the floor, heading along the way,
/// the robot wandering sideways within the passage, tilted by slope and gait.
[[nodiscard]] std::vector<Waypoint> drive(const RouteGraph& routes, const std::vector<Leg>& legs,
                                          const simulation_parameters::Platform& platform, double spacing_m,
                                          std::size_t count, std::uint64_t seed);

/// Shortest ways over the graph. O(places²) memory.
class Distances {
 public:
  explicit Distances(const RouteGraph& routes);
  [[nodiscard]] double between(std::size_t a, std::size_t b) const { return distance_[a * count_ + b]; }
  /// First passage on the shortest way from a to b. \pre a != b
  [[nodiscard]] std::size_t first_passage(std::size_t a, std::size_t b) const {
    return first_[a * count_ + b];
  }
  /// Between points on passages.
  [[nodiscard]] double between(const RouteGraph& routes, const Waypoint& a, const Waypoint& b) const;

 private:
  std::size_t count_;
  std::vector<float> distance_;
  std::vector<std::uint32_t> first_;
};

}  // namespace loopwise::simulation_detail
