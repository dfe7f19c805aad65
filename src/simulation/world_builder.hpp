// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Builds worlds from passages, rooms and objects. The surface and the routes follow from these.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/random.hpp>
#include <loopwise/simulation/world.hpp>

#include "../core/constants.hpp"
#include "parameters.hpp"
#include "surface.hpp"

namespace loopwise::simulation_detail {

namespace parameters = simulation_parameters;
using PlaceKind = RouteGraph::PlaceKind;

inline constexpr double kWallClearance = 0.9;  ///< From a robot's centre to a wall, at least, m.

inline double draw(Rng& rng, const parameters::Range& range) {
  return rng.uniform(range.low, range.high);
}

/// Size and shape of a passage.
struct Style {
  Shape::Kind kind = Shape::Kind::kPassage;
  double half_width = 2.0;
  double height = 2.3;
  double roof_sag = 0.0;
  double meander = 0.0;
  double size_change = 0.0;  ///< Relative, from piece to piece.
  const parameters::Roughness* roughness = nullptr;
  bool corridor = true;
  bool grounded = false;   ///< The floor follows the ground.
  double clearance = 0.9;  ///< From a robot's centre to the walls, at least, m.
};

/// Collects voids, routes and objects. Objects are added last, where no robot drives.
class Builder {
 public:
  explicit Builder(std::uint64_t seed) : rng_(combine_seeds(seed, 1)), seed_(seed) {}

  Rng& rng() { return rng_; }
  /// \param level_south_of the ground is level for smaller y, where buildings are.
  void set_undulation(double amplitude_m, double level_south_of = -1e9) {
    undulation_m_ = amplitude_m;
    level_south_of_ = level_south_of;
  }

  /// Height of the seam.
  [[nodiscard]] double ground(double x, double y) const {
    if (undulation_m_ == 0.0) return 0.0;
    const auto noise = [&](double u, double v) {
      return gradient_noise(Eigen::Vector3d(u / 120.0, v / 120.0, 0.37), combine_seeds(seed_, 2));
    };
    // The undulation fades in over the first 30 m, so that robots start on level ground.
    const double fade =
        std::min(1.0, std::hypot(x, y) / 30.0) * std::clamp((y - level_south_of_) / 15.0, 0.0, 1.0);
    return undulation_m_ * fade * (noise(x, y) - noise(0.0, 0.0));
  }

  std::size_t place(double x, double y, PlaceKind kind = PlaceKind::kJunction) {
    return place(Eigen::Vector3d(x, y, ground(x, y)), kind);
  }
  std::size_t place(const Eigen::Vector3d& position, PlaceKind kind = PlaceKind::kJunction) {
    routes_.places.push_back({position, kind});
    return routes_.places.size() - 1;
  }
  [[nodiscard]] const Eigen::Vector3d& at(std::size_t place) const { return routes_.places[place].position; }

  /// Cuts a passage between two places and adds it to the routes. The passage winds by the style's meander.
  void passage(std::size_t from, std::size_t to, const Style& style);

  /// Cuts the void without a route.
  void cut(const std::vector<Eigen::Vector3d>& path, const Style& style);
  void add(const Shape& shape) { shapes_.push_back(shape); }

  /// Adds the route without a void.
  void way(std::size_t from, std::size_t to, std::vector<Eigen::Vector3d> path, double half_width,
           bool corridor) {
    RouteGraph::Passage p{from, to, std::move(path), half_width, 0.0, corridor};
    for (std::size_t i = 1; i < p.path.size(); ++i) p.length_m += (p.path[i] - p.path[i - 1]).norm();
    routes_.passages.push_back(std::move(p));
  }

  [[nodiscard]] double passage_length() const {
    double sum = 0.0;
    for (const auto& p : routes_.passages) sum += p.length_m;
    return sum;
  }

  /// Adds a box on the floor, unless robots drive there.
  void box(const Eigen::Vector3d& floor, double length, double width, double height, double yaw) {
    box(floor, length, width, height, yaw, 0.5 * std::hypot(length, width));
  }
  /// \param reach extent towards the route, m
  void box(const Eigen::Vector3d& floor, double length, double width, double height, double yaw,
           double reach);
  void post(const Eigen::Vector3d& floor, double radius, double height);
  /// Adds a pipe overhead or along a wall, where no robot drives.
  void pipe(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double radius);
  void step(const Eigen::Vector3d& floor, const Eigen::Vector3d& u, const Eigen::Vector3d& v, double height);

  [[nodiscard]] World build(WorldKind kind, double cell, int threads, const StopToken& stop);

  [[nodiscard]] const RouteGraph& routes() const { return routes_; }

 private:
  struct Foot {
    Eigen::Vector3d centre;
    double radius;
  };

  [[nodiscard]] bool out_of_the_way(const Foot& foot) const;
  void mark_dead_ends();

  Rng rng_;
  std::uint64_t seed_;
  double undulation_m_ = 0.0;
  double level_south_of_ = 0.0;
  std::vector<Shape> shapes_;
  RouteGraph routes_;
  std::vector<std::function<void(TriangleMesh&)>> things_;
  std::vector<Foot> foot_;
};

}  // namespace loopwise::simulation_detail
