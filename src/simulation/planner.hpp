// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Drives of the robots: routes of an exploring team over the route graph, then poses along the routes.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/simulation/world.hpp>

#include "parameters.hpp"

namespace loopwise::simulation_detail {

/// A passage that a robot drives from end to end.
struct Leg {
  std::size_t passage;
  bool forward;
};

/// Routes of `robots` robots that start at the gate and explore together. Each route is longer than
/// `length_m`, so that the caller can cut it there. Most robots are back at the gate at that length.
[[nodiscard]] std::vector<std::vector<Leg>> plan_routes(const RouteGraph& routes, int robots, double length_m,
                                                        std::uint64_t seed);

/// Pose, time and place of one node of a drive.
struct Waypoint {
  Eigen::Isometry3d T_world_body;
  double time_s = 0.0;  ///< Since the robot's start.
  std::size_t passage = 0;
  double along_m = 0.0;  ///< From the passage's `from`.
};

/// Poses at every `spacing_m` of the route, at most `count`. The sensor is above the floor and heads along
/// the route. The robot wanders sideways within the passage and tilts with slope and gait.
[[nodiscard]] std::vector<Waypoint> drive(const RouteGraph& routes, const std::vector<Leg>& legs,
                                          const simulation_parameters::Platform& platform, double spacing_m,
                                          std::size_t count, std::uint64_t seed);

/// Shortest paths over the graph. O(places²) memory.
class Distances {
 public:
  explicit Distances(const RouteGraph& routes);
  [[nodiscard]] double between(std::size_t a, std::size_t b) const { return distance_[a * count_ + b]; }
  /// First passage of the shortest path from a to b. \pre a != b
  [[nodiscard]] std::size_t first_passage(std::size_t a, std::size_t b) const {
    return first_[a * count_ + b];
  }
  /// Length of the shortest path between two points on passages.
  [[nodiscard]] double between(const RouteGraph& routes, const Waypoint& a, const Waypoint& b) const;

 private:
  std::size_t count_;
  std::vector<float> distance_;
  std::vector<std::uint32_t> first_;
};

}  // namespace loopwise::simulation_detail
