// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise {

/// The paper's four environments, in kind and size.
enum class WorldKind {
  kTunnel,  ///< Coal mine: long featureless entries, parallel and joined by cross-cuts.
  kUrban,   ///< Power plant: two floors joined by stairs, corridors, rooms, open halls.
  kFinals,  ///< Tunnel, cave and urban sections that start from one gate.
  kMine,    ///< Room-and-pillar limestone mine: wide, high drifts around pillars.
};
[[nodiscard]] inline EnumNames<WorldKind> enum_names(WorldKind) {
  return {{WorldKind::kTunnel, "tunnel"},
          {WorldKind::kUrban, "urban"},
          {WorldKind::kFinals, "finals"},
          {WorldKind::kMine, "mine"}};
}

/// Triangles in the world frame, metres. Front and back are alike.
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;                ///< Corners, shared between triangles.
  std::vector<std::array<std::uint32_t, 3>> triangles;  ///< Three numbers of vertices each.
};

/// The free space of robots: places joined by passages. The gate, the start of all robots, is place 0.
struct RouteGraph {
  /// The kind of place.
  enum class PlaceKind {
    kJunction,  ///< A junction of passages.
    kDeadEnd,   ///< The end of a passage.
    kRoom,      ///< In a room or hall.
  };
  /// A node of the graph.
  struct Place {
    Eigen::Vector3d position;               ///< On the floor, world frame, m.
    PlaceKind kind = PlaceKind::kJunction;  ///< Junction, dead end or room.
  };
  /// An edge of the graph.
  struct Passage {
    std::size_t from;                   ///< Place at the path's beginning.
    std::size_t to;                     ///< Place at the path's end.
    std::vector<Eigen::Vector3d> path;  ///< On the floor, both ends included.
    double half_width_m;                ///< Free to drive to either side of the path.
    double length_m;                    ///< Along the path.
    bool corridor;                      ///< A passage between two walls; false inside rooms and halls.
  };
  std::vector<Place> places;      ///< By number.
  std::vector<Passage> passages;  ///< In any order.
};

/// A world: its surfaces and passages. The gate is at the origin, x points inwards, z is up.
struct LOOPWISE_EXPORT World {
  WorldKind kind = WorldKind::kTunnel;  ///< Which of the four it is.
  TriangleMesh mesh;                    ///< All surfaces.
  RouteGraph routes;                    ///< The passages.
  /// Total length of the passages, m.
  [[nodiscard]] double passage_length_m() const;
};

/// Builds a world in which robots can drive `length_m` in total as an exploring team does: passages for about
/// half of it. The same arguments give the same bits for any number of threads.
/// `threads` 0: one per processor.
/// \throws OptionError unless 60 <= length_m <= 60000. \returns an unfinished mesh if a stop is requested;
/// the caller must discard it.
[[nodiscard]] LOOPWISE_EXPORT World make_world(WorldKind kind, double length_m, std::uint64_t seed,
                                               int threads = 0, const StopToken& stop = {});

}  // namespace loopwise
