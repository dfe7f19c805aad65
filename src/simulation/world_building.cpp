// SPDX-License-Identifier: BSD-3-Clause
// Buildings of a power plant.
#include <array>

#include "world_plans.hpp"

namespace loopwise::simulation_detail {
namespace {

/// An area between corridors: a hall, or rooms.
struct Block {
  int i, j;  ///< Column and row.
  Eigen::Vector3d low, high;
  [[nodiscard]] double size_x() const { return high.x() - low.x(); }
  [[nodiscard]] double size_y() const { return high.y() - low.y(); }
};

/// One building, planned floor by floor.
class Building {
 public:
  Building(Builder& builder, const Eigen::Vector2d& corner, int columns, int rows, int floors)
      : builder_(builder),
        rng_(builder.rng()),
        columns_(columns),
        rows_(rows),
        floors_(floors),
        xs_{corner.x()},
        ys_{corner.y()},
        tall_(static_cast<std::size_t>(columns * rows), 0) {
    for (int i = 0; i < columns; ++i) xs_.push_back(xs_.back() + draw(rng_, u_.block_x_m));
    for (int j = 0; j < rows; ++j) ys_.push_back(ys_.back() + draw(rng_, u_.block_y_m));
    for (int i = 0; i <= columns; ++i) width_x_.push_back(draw(rng_, u_.corridor_width_m));
    for (int j = 0; j <= rows; ++j) width_y_.push_back(draw(rng_, u_.corridor_width_m));
  }

  /// \returns the corridor places of the ground floor
  PlaceGrid plan() {
    for (int floor = 0; floor < floors_; ++floor) plan_floor(floor);
    if (floors_ < 2) return ground_floor_;
    // A flight of stairs outside the west wall and one outside the east wall.
    for (const bool east : {false, true}) plan_stairs(east);
    return ground_floor_;
  }

 private:
  [[nodiscard]] double x_of(int i) const { return xs_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] double y_of(int j) const { return ys_[static_cast<std::size_t>(j)]; }

  [[nodiscard]] Style corridor(double width) const {
    Style s;
    s.half_width = 0.5 * width;
    s.height = u_.room_height_m - 0.4;
    s.roughness = &parameters::kConcrete;
    return s;
  }
  [[nodiscard]] static Shape box_shape(const Eigen::Vector3d& low, double sx, double sy, double height) {
    Shape s;
    s.kind = Shape::Kind::kBox;
    s.a = low + Eigen::Vector3d(0.5 * sx, 0.5 * sy, 0.0);
    s.half_width = 0.5 * sx;
    s.half_length = 0.5 * sy;
    s.height = height;
    s.roughness = &parameters::kConcrete;
    return s;
  }
  void flat_passage(std::size_t from, std::size_t to, double width) {
    const std::vector<Eigen::Vector3d> path{builder_.at(from), builder_.at(to)};
    builder_.cut(path, corridor(width));
    builder_.way(from, to, path, std::max(0.15, 0.5 * width - kWallClearance), true);
  }
  void doorway(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double width) {
    Style s = corridor(width);
    s.height = u_.door_height_m;
    builder_.cut({a, b}, s);
  }

  void plan_floor(int floor);
  [[nodiscard]] Block block_at(int i, int j, double z) const;
  void plan_hall(const Block& block, double height);
  void plan_rooms(const Block& block);
  void open_door(const Block& block, double x, bool north, double width, std::size_t room,
                 const Eigen::Vector3d& inside);
  void plan_corridors(const PlaceGrid& junctions, double z);
  void plan_stairs(bool east);
  void furnish_room(const Eigen::Vector3d& low, double sx, double sy);
  void furnish_hall(const Eigen::Vector3d& low, double sx, double sy, double height);

  const decltype(parameters::kUrban)& u_ = parameters::kUrban;
  Builder& builder_;
  Rng& rng_;
  int columns_, rows_, floors_;
  std::vector<double> xs_, ys_;
  std::vector<double> width_x_, width_y_;  // of the corridors along y and along x
  std::vector<char> tall_;                 // by block: a hall that reaches through the upper floor
  PlaceGrid ground_floor_, upper_floor_;
  /// Doors of the floor on the corridors along x, by (column, row of the corridor): x of the door and its
  /// place.
  std::map<std::pair<int, int>, std::vector<std::pair<double, std::size_t>>> doors_;
};

void Building::furnish_room(const Eigen::Vector3d& low, double sx, double sy) {
  const int count = static_cast<int>(sx * sy / 9.0);
  for (int k = 0; k < count; ++k) {
    const double length = rng_.uniform(0.6, 1.8), depth = rng_.uniform(0.4, 0.8),
                 height = rng_.uniform(0.7, 2.0);
    const bool along_x = rng_.uniform() < 0.5, far = rng_.uniform() < 0.5;
    Eigen::Vector3d p = low;
    if (along_x) {
      p += Eigen::Vector3d(rng_.uniform(0.1, 0.9) * sx, far ? sy - 0.5 * depth : 0.5 * depth, 0.0);
    } else {
      p += Eigen::Vector3d(far ? sx - 0.5 * depth : 0.5 * depth, rng_.uniform(0.1, 0.9) * sy, 0.0);
    }
    builder_.box(p, length, depth, height, along_x ? 0.0 : 0.5 * kPi);
  }
}

void Building::furnish_hall(const Eigen::Vector3d& low, double sx, double sy, double height) {
  const double pitch = draw(rng_, u_.column_spacing_m);
  double x = 0.5 * pitch;
  while (x < sx) {
    for (const double y : {0.12 * sy, 0.88 * sy})
      builder_.post(low + Eigen::Vector3d(x, y, 0.0), 0.25, height + 0.3);
    x += pitch;
  }
  const int machines = 2 + static_cast<int>(rng_.below(3));
  for (int k = 0; k < machines; ++k) {
    const Eigen::Vector3d p =
        low + Eigen::Vector3d(rng_.uniform(0.3, 0.7) * sx, rng_.uniform(0.35, 0.65) * sy, 0.0);
    if (rng_.uniform() < 0.5) {
      builder_.post(p, rng_.uniform(0.6, 1.3), rng_.uniform(1.5, 4.0));
    } else {
      builder_.box(p, rng_.uniform(1.5, 4.0), rng_.uniform(1.0, 1.8), rng_.uniform(1.0, 2.5),
                   0.5 * kPi * (rng_.uniform() < 0.5));
    }
  }
  for (const double y : {0.3 * sy, 0.7 * sy}) {
    builder_.pipe(low + Eigen::Vector3d(0.0, y, 0.7 * height), low + Eigen::Vector3d(sx, y, 0.7 * height),
                  0.2);
  }
  furnish_room(low, sx, sy);
}

/// Connects the door in the wall with the corridor behind it, on the side `north` of the block.
void Building::open_door(const Block& block, double x, bool north, double width, std::size_t room,
                         const Eigen::Vector3d& inside) {
  const double z = block.low.z();
  const int j = north ? block.j + 1 : block.j;
  const std::size_t place = builder_.place(Eigen::Vector3d(x, y_of(j), z));
  doors_[{block.i, j}].emplace_back(x, place);
  const Eigen::Vector3d sill(x, north ? block.high.y() - 0.7 : block.low.y() + 0.7, z);
  doorway(builder_.at(place), sill, width);
  builder_.way(place, room, {builder_.at(place), sill, inside}, 0.15, false);
}

void Building::plan_hall(const Block& block, double height) {
  const Eigen::Vector3d& low = block.low;
  const double sx = block.size_x(), sy = block.size_y();
  builder_.add(box_shape(low, sx, sy, height));
  std::vector<std::size_t> ring;
  for (const auto& [fx, fy] :
       {std::pair(0.2, 0.25), std::pair(0.8, 0.25), std::pair(0.8, 0.75), std::pair(0.2, 0.75)}) {
    ring.push_back(builder_.place(low + Eigen::Vector3d(fx * sx, fy * sy, 0.0), PlaceKind::kRoom));
  }
  for (std::size_t k = 0; k < 4; ++k) {
    builder_.way(ring[k], ring[(k + 1) % 4], {builder_.at(ring[k]), builder_.at(ring[(k + 1) % 4])}, 0.4,
                 false);
  }
  open_door(block, low.x() + 0.2 * sx, false, 2.0 * u_.door_width_m, ring[0], builder_.at(ring[0]));
  open_door(block, low.x() + 0.8 * sx, true, 2.0 * u_.door_width_m, ring[2], builder_.at(ring[2]));
  furnish_hall(low, sx, sy, height);
}

void Building::plan_rooms(const Block& block) {
  const Eigen::Vector3d& low = block.low;
  const double sx = block.size_x(), sy = block.size_y(), z = low.z();
  const double split_x = rng_.uniform(0.4, 0.6) * sx;
  const bool two_rows = rng_.uniform() < 0.6;
  const double split_y = two_rows ? rng_.uniform(0.42, 0.58) * sy : sy;
  const double half_wall = 0.5 * u_.wall_m;
  for (int row = 0; row < (two_rows ? 2 : 1); ++row) {
    const double y0 = row == 0 ? 0.0 : split_y + half_wall;
    const double y1 = row == 0 && two_rows ? split_y - half_wall : sy;
    const bool north = two_rows ? row == 1 : rng_.uniform() < 0.5;
    std::array<std::size_t, 2> pair{};
    std::array<Eigen::Vector3d, 2> centre;
    for (std::size_t k = 0; k < 2; ++k) {
      const double x0 = k == 0 ? 0.0 : split_x + half_wall, x1 = k == 0 ? split_x - half_wall : sx;
      const Eigen::Vector3d room_low = low + Eigen::Vector3d(x0, y0, 0.0);
      builder_.add(box_shape(room_low, x1 - x0, y1 - y0, u_.room_height_m));
      centre[k] = room_low + Eigen::Vector3d(0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.0);
      pair[k] = builder_.place(centre[k], PlaceKind::kRoom);
      open_door(block, room_low.x() + rng_.uniform(0.3, 0.7) * (x1 - x0), north, u_.door_width_m, pair[k],
                centre[k]);
      furnish_room(room_low, x1 - x0, y1 - y0);
    }
    if (rng_.uniform() < u_.inner_door_share) {
      const Eigen::Vector3d a(low.x() + split_x - 0.8, centre[0].y(), z),
          b(low.x() + split_x + 0.8, centre[0].y(), z);
      doorway(a, b, u_.door_width_m);
      builder_.way(pair[0], pair[1], {centre[0], a, b, centre[1]}, 0.15, false);
    }
  }
}

Block Building::block_at(int i, int j, double z) const {
  const auto ci = static_cast<std::size_t>(i), cj = static_cast<std::size_t>(j);
  const Eigen::Vector3d low(xs_[ci] + 0.5 * width_x_[ci] + u_.wall_m,
                            ys_[cj] + 0.5 * width_y_[cj] + u_.wall_m, z);
  const Eigen::Vector3d high(xs_[ci + 1] - 0.5 * width_x_[ci + 1] - u_.wall_m,
                             ys_[cj + 1] - 0.5 * width_y_[cj + 1] - u_.wall_m, z);
  return {i, j, low, high};
}

void Building::plan_floor(int floor) {
  const double z = floor * u_.storey_m;
  PlaceGrid& junctions = floor == 0 ? ground_floor_ : upper_floor_;
  for (int i = 0; i <= columns_; ++i) {
    for (int j = 0; j <= rows_; ++j) {
      junctions[{i, j}] = builder_.place(Eigen::Vector3d(x_of(i), y_of(j), z));
    }
  }
  doors_.clear();
  for (int i = 0; i < columns_; ++i) {
    for (int j = 0; j < rows_; ++j) {
      char& is_tall = tall_[static_cast<std::size_t>(j * columns_ + i)];
      if (floor > 0 && is_tall) continue;
      const Block block = block_at(i, j, z);
      if (rng_.uniform() < u_.hall_share) {
        const bool through = floors_ > 1 && floor == 0;
        is_tall = through ? 1 : 0;
        plan_hall(block, through ? u_.hall_height_m : u_.room_height_m);
      } else {
        plan_rooms(block);
      }
    }
  }
  plan_corridors(junctions, z);
}

void Building::plan_corridors(const PlaceGrid& junctions, double z) {
  for (int i = 0; i <= columns_; ++i) {
    for (int j = 0; j < rows_; ++j) {
      flat_passage(junctions.at({i, j}), junctions.at({i, j + 1}), width_x_[static_cast<std::size_t>(i)]);
    }
  }
  for (int j = 0; j <= rows_; ++j) {
    const double width = width_y_[static_cast<std::size_t>(j)];
    for (int i = 0; i < columns_; ++i) {
      const std::pair<int, int> cell(i, j);
      auto& list = doors_[cell];
      std::sort(list.begin(), list.end());
      std::size_t from = junctions.at(cell);
      for (const auto& [x, place] : list) {
        flat_passage(from, place, width);
        from = place;
      }
      flat_passage(from, junctions.at({i + 1, j}), width);
    }
    // Cable trays and pipes under the corridor's ceiling.
    const double y = y_of(j) + 0.25 * width;
    builder_.pipe(Eigen::Vector3d(xs_.front(), y, z + 2.5), Eigen::Vector3d(xs_.back(), y, z + 2.5), 0.1);
  }
}

void Building::plan_stairs(bool east) {
  const int i = east ? columns_ : 0, j = east ? rows_ - 1 : 0;
  const double x = x_of(i) + (east ? 2.6 : -2.6);
  const std::size_t low = ground_floor_.at({i, j}), high = upper_floor_.at({i, j + 1});
  const Eigen::Vector3d a = builder_.at(low), b = builder_.at(high);
  const Eigen::Vector3d a1(x, a.y(), a.z()), a2(x, a.y() + 1.2, a.z()), b2(x, b.y() - 1.2, b.z()),
      b1(x, b.y(), b.z());
  Style s = corridor(1.7);
  s.height = 2.6;
  builder_.cut({a, a1, a2, b2, b1, b}, s);
  builder_.way(low, high, {a, a1, a2, b2, b1, b}, 0.15, true);
  const int steps = static_cast<int>(std::lround(u_.storey_m / u_.step_rise_m));
  const Eigen::Vector3d run = (b2 - a2) / steps;
  for (int k = 0; k < steps; ++k) {
    const Eigen::Vector3d tread = a2 + (k + 0.5) * run;
    builder_.step(tread, Eigen::Vector3d(1.0, 0.0, 0.0), Eigen::Vector3d(0.0, 0.5 * run.y(), 0.0),
                  0.5 * run.z());
  }
}

}  // namespace

PlaceGrid plan_building(Builder& builder, const Eigen::Vector2d& corner, int columns, int rows, int floors) {
  return Building(builder, corner, columns, rows, floors).plan();
}

}  // namespace loopwise::simulation_detail
