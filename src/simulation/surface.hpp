// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Rock with voids: the void is a union of shapes, and triangles represent its rough boundary.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/stop_token.hpp>
#include <loopwise/simulation/world.hpp>

#include "parameters.hpp"

namespace loopwise::simulation_detail {

/// Smooth noise of mean 0 and root mean square 1, from gradients on the integer lattice (Perlin 1985, 2002).
[[nodiscard]] double gradient_noise(const Eigen::Vector3d& p, std::uint64_t seed);

/// A void in the rock above a floor.
struct Shape {
  enum class Kind {
    kPassage,  ///< Rounded ends in plan, straight walls, arched roof, from a to b.
    kBox,      ///< Flat walls: half_width by half_length about a, turned by yaw.
    kTube,     ///< Elliptic section above a flat floor, from a to b; a chamber if they coincide.
  };
  Kind kind = Kind::kPassage;
  Eigen::Vector3d a = Eigen::Vector3d::Zero();  ///< On the floor.
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  double half_width = 1.0;
  double half_length = 1.0;
  double height = 2.0;
  double roof_sag = 0.0;
  double yaw = 0.0;
  bool grounded = false;  ///< The floor follows the ground of the world instead of a and b.
  const simulation_parameters::Roughness* roughness = nullptr;
};

/// Height of the ground at (x, y), m: slopes are gentle.
using Ground = std::function<double(double, double)>;

/// Distance to the boundary, negative in the void. The sign is exact, and the slope is at most about 1.5.
/// \param relief is added to walls and roof, and its `floor_share` to the floor
/// \param ground height at the point, for shapes that follow the ground
[[nodiscard]] double void_distance(const Shape& shape, const Eigen::Vector3d& p, double relief,
                                   double ground);

/// The boundary of the union by dual contouring (Ju et al. 2002) with cells of `cell` metres, tile by tile.
[[nodiscard]] TriangleMesh extract_surface(const std::vector<Shape>& shapes, const Ground& ground,
                                           double cell, std::uint64_t seed, int threads,
                                           const StopToken& stop);

}  // namespace loopwise::simulation_detail
