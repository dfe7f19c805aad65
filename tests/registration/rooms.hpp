// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Rooms that look the same from several places, and scans of them by casting rays.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/random.hpp>

namespace loopwise::testing {

/// Flat surfaces that stop rays.
class Room {
 public:
  /// The parallelogram of two perpendicular edges at a corner.
  void add(const Eigen::Vector3d& corner, const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
    Face face;
    face.corner = corner;
    face.normal = a.cross(b).normalized();
    face.a = a / a.squaredNorm();
    face.b = b / b.squaredNorm();
    faces_.push_back(face);
  }
  /// A wall over a line on the ground.
  void add_wall(const Eigen::Vector2d& from, const Eigen::Vector2d& to, double bottom, double top) {
    add({from.x(), from.y(), bottom}, {to.x() - from.x(), to.y() - from.y(), 0.0}, {0.0, 0.0, top - bottom});
  }
  /// An upright box about a centre on the ground.
  void add_box(const Eigen::Vector2d& centre, double length, double width, double heading, double bottom,
               double top) {
    const Eigen::Vector2d u = 0.5 * length * Eigen::Vector2d(std::cos(heading), std::sin(heading));
    const Eigen::Vector2d v = 0.5 * width * Eigen::Vector2d(-std::sin(heading), std::cos(heading));
    const std::vector<Eigen::Vector2d> corners{centre + u + v, centre - u + v, centre - u - v,
                                               centre + u - v};
    add_walls(corners, bottom, top);
    add({corners[2].x(), corners[2].y(), top}, {2.0 * u.x(), 2.0 * u.y(), 0.0},
        {2.0 * v.x(), 2.0 * v.y(), 0.0});
  }
  /// Walls along a closed line.
  void add_walls(const std::vector<Eigen::Vector2d>& corners, double bottom, double top) {
    for (std::size_t i = 0; i < corners.size(); ++i) {
      add_wall(corners[i], corners[(i + 1) % corners.size()], bottom, top);
    }
  }
  /// A level square of `half` metres to all sides of the origin.
  void add_level(double half, double z) { add({-half, -half, z}, {2.0 * half, 0, 0}, {0, 2.0 * half, 0}); }

  /// What a sensor of `rings` from −40° to 40° and `columns` sees, in its frame; noise along the ray.
  [[nodiscard]] std::shared_ptr<PointCloud> scan(const Eigen::Isometry3d& pose, double noise_m, Rng& rng,
                                                 int rings = 16, int columns = 360) const {
    constexpr double kPi = 3.14159265358979323846, kRangeM = 60.0;
    auto cloud = std::make_shared<PointCloud>();
    const double phase = rng.uniform();
    for (int column = 0; column < columns; ++column) {
      const double azimuth = 2.0 * kPi * (column + phase) / columns;
      for (int ring = 0; ring < rings; ++ring) {
        const double elevation = kPi / 180.0 * (-40.0 + 80.0 * (ring + 0.5) / rings);
        const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth),
                                  std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        const double range = cast(pose.translation(), pose.linear() * ray);
        if (range < 0.3 || range > kRangeM) continue;
        cloud->points.push_back(((range + noise_m * rng.normal()) * ray).cast<float>());
      }
    }
    return cloud;
  }

 private:
  struct Face {
    Eigen::Vector3d corner, normal, a, b;  // edges divided by their squared lengths
  };
  [[nodiscard]] double cast(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
    double nearest = std::numeric_limits<double>::infinity();
    for (const Face& face : faces_) {
      const double slope = face.normal.dot(ray);
      if (std::abs(slope) < 1e-9) continue;
      const double range = face.normal.dot(face.corner - from) / slope;
      if (range <= 0.0 || range >= nearest) continue;
      const Eigen::Vector3d q = from + range * ray - face.corner;
      const double u = face.a.dot(q), v = face.b.dot(q);
      if (u >= 0.0 && u <= 1.0 && v >= 0.0 && v <= 1.0) nearest = range;
    }
    return nearest;
  }
  std::vector<Face> faces_;
};

/// A room and two places of a sensor in it.
struct RoomPair {
  Room room;
  Eigen::Isometry3d source = Eigen::Isometry3d::Identity(), target = Eigen::Isometry3d::Identity();
  Eigen::Vector3d along = Eigen::Vector3d::UnitX();  ///< Where a wrong guess is worst.
};

[[nodiscard]] inline Eigen::Isometry3d room_pose(double x, double y, double z, Rng& rng) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() << x, y, z;
  T.linear() = (Eigen::AngleAxisd(rng.uniform(-3.14, 3.14), Eigen::Vector3d::UnitZ()) *
                Eigen::AngleAxisd(0.03 * rng.normal(), Eigen::Vector3d::UnitY()) *
                Eigen::AngleAxisd(0.03 * rng.normal(), Eigen::Vector3d::UnitX()))
                   .toRotationMatrix();
  return T;
}

/// Both places drawn within a rectangle about the origin, 1.2 m above the ground.
inline void place_sensors(RoomPair& pair, double half_x, double half_y, Rng& rng) {
  for (Eigen::Isometry3d* pose : {&pair.source, &pair.target}) {
    *pose = room_pose(rng.uniform(-half_x, half_x), rng.uniform(-half_y, half_y), 1.2, rng);
  }
}

/// Four walls, with a ceiling or without; `objects` boxes stand in it.
[[nodiscard]] inline RoomPair rectangle_room(Rng& rng, int objects) {
  RoomPair pair;
  const double length = rng.uniform(7.0, 20.0);
  const double width = rng.uniform() < 0.3 ? length : rng.uniform(5.0, 12.0);
  pair.room.add_walls({{-length / 2, -width / 2},
                       {length / 2, -width / 2},
                       {length / 2, width / 2},
                       {-length / 2, width / 2}},
                      0.0, 3.0);
  pair.room.add_level(30.0, 0.0);
  if (rng.uniform() < 0.5) pair.room.add_level(30.0, 3.0);
  for (int i = 0; i < objects; ++i) {
    const double side = i % 2 == 0 ? 1.0 : -1.0;
    pair.room.add_box({rng.uniform(-0.4, 0.4) * length, side * 0.44 * width}, rng.uniform(0.5, 1.5), 0.5, 0.0,
                      0.0, rng.uniform(0.8, 2.0));
  }
  place_sensors(pair, 0.3 * length, 0.3 * width, rng);
  return pair;
}

/// A regular polygon of three to eight walls.
[[nodiscard]] inline RoomPair polygon_room(Rng& rng) {
  RoomPair pair;
  const auto sides = 3 + static_cast<int>(rng.below(6));
  const double radius = rng.uniform(5.0, 10.0);
  std::vector<Eigen::Vector2d> corners;
  for (int i = 0; i < sides; ++i) {
    const double angle = 2.0 * 3.14159265358979 * i / sides;
    corners.emplace_back(radius * std::cos(angle), radius * std::sin(angle));
  }
  pair.room.add_walls(corners, 0.0, 3.0);
  pair.room.add_level(30.0, 0.0);
  if (rng.uniform() < 0.5) pair.room.add_level(30.0, 3.0);
  place_sensors(pair, 0.25 * radius, 0.25 * radius, rng);
  return pair;
}

/// A long corridor with equal pillars at equal distances on both walls, or a wide hall on a grid of them.
[[nodiscard]] inline RoomPair pillar_hall(Rng& rng) {
  RoomPair pair;
  const double period = rng.uniform(3.0, 6.0), half = 50.0;
  const bool grid = rng.uniform() < 0.5;
  const double half_width = grid ? 2.5 * period : rng.uniform(2.5, 3.5);
  const double size = rng.uniform(0.4, 0.8);
  pair.room.add_wall({-half, -half_width}, {half, -half_width}, 0.0, 3.0);
  pair.room.add_wall({-half, half_width}, {half, half_width}, 0.0, 3.0);
  pair.room.add_level(60.0, 0.0);
  pair.room.add_level(60.0, 3.0);
  std::vector<double> rows{-half_width + size / 2, half_width - size / 2};
  if (grid) rows = {-2.0 * period, -period, 0.0, period, 2.0 * period};
  for (double x = -half; x <= half; x += period) {
    for (const double y : rows) pair.room.add_box({x, y}, size, size, 0.0, 0.0, 3.0);
  }
  const double half_y = grid ? 0.5 * period - size : 1.0;
  place_sensors(pair, 4.0, half_y, rng);
  for (Eigen::Isometry3d* pose : {&pair.source, &pair.target}) {
    if (grid) pose->translation().y() += 0.5 * period;
  }
  return pair;
}

/// Corridors that meet: four arms, or three.
[[nodiscard]] inline RoomPair crossing(Rng& rng) {
  RoomPair pair;
  const double w = rng.uniform(1.2, 2.5), far = 40.0;
  const bool tee = rng.uniform() < 0.3;
  for (const double side : {-1.0, 1.0}) {
    pair.room.add_wall({side * w, w}, {side * far, w}, 0.0, 3.0);
    pair.room.add_wall({side * w, w}, {side * w, far}, 0.0, 3.0);
    if (tee) continue;
    pair.room.add_wall({side * w, -w}, {side * far, -w}, 0.0, 3.0);
    pair.room.add_wall({side * w, -w}, {side * w, -far}, 0.0, 3.0);
  }
  if (tee) pair.room.add_wall({-far, -w}, {far, -w}, 0.0, 3.0);
  pair.room.add_level(45.0, 0.0);
  pair.room.add_level(45.0, 3.0);
  place_sensors(pair, 0.8 * w, 0.8 * w, rng);
  return pair;
}

/// A long flight of equal steps between two walls; the sensors stand on it.
[[nodiscard]] inline RoomPair staircase(Rng& rng) {
  RoomPair pair;
  const double rise = rng.uniform(0.15, 0.19), run = rng.uniform(0.26, 0.34),
               half_width = rng.uniform(0.8, 2.0);
  constexpr int kSteps = 60;
  for (int i = -kSteps; i < kSteps; ++i) {
    pair.room.add({i * run, -half_width, i * rise}, {run, 0, 0}, {0, 2.0 * half_width, 0});
    pair.room.add({i * run, -half_width, (i - 1) * rise}, {0, 2.0 * half_width, 0}, {0, 0, rise});
  }
  const double end = kSteps * run, height = kSteps * rise + 4.0;
  pair.room.add_wall({-end, -half_width}, {end, -half_width}, -height, height);
  pair.room.add_wall({-end, half_width}, {end, half_width}, -height, height);
  for (Eigen::Isometry3d* pose : {&pair.source, &pair.target}) {
    const double x = rng.uniform(-2.0, 2.0);
    *pose = room_pose(x, rng.uniform(-0.3, 0.3), std::floor(x / run) * rise + 1.2, rng);
  }
  pair.along = Eigen::Vector3d(run, 0.0, rise).normalized();
  return pair;
}

/// A room full of different boxes: nothing in it repeats.
[[nodiscard]] inline RoomPair furnished_room(Rng& rng) {
  RoomPair pair = rectangle_room(rng, 0);
  for (int i = 0; i < 10; ++i) {
    pair.room.add_box({rng.uniform(-9.0, 9.0), rng.uniform(-5.0, 5.0)}, rng.uniform(0.4, 3.0),
                      rng.uniform(0.4, 2.0), rng.uniform(0.0, 3.1), 0.0, rng.uniform(0.5, 2.9));
  }
  return pair;
}

/// Names of the kinds that make_room() knows.
[[nodiscard]] inline std::vector<std::string> room_kinds() {
  return {"rectangle", "objects", "polygon", "pillars", "crossing", "stairs", "furnished"};
}

[[nodiscard]] inline RoomPair make_room(const std::string& kind, Rng& rng) {
  if (kind == "rectangle") return rectangle_room(rng, 0);
  if (kind == "objects") return rectangle_room(rng, 1 + static_cast<int>(rng.below(3)));
  if (kind == "polygon") return polygon_room(rng);
  if (kind == "pillars") return pillar_hall(rng);
  if (kind == "crossing") return crossing(rng);
  if (kind == "stairs") return staircase(rng);
  return furnished_room(rng);
}

}  // namespace loopwise::testing
