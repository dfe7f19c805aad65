// SPDX-License-Identifier: BSD-3-Clause
#include "surface.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

#include <Eigen/Cholesky>

#include <loopwise/core/random.hpp>
#include <loopwise/core/thread_pool.hpp>

namespace loopwise::simulation_detail {
namespace {

using simulation_parameters::Roughness;

/// Measured over 2·10^5 points: the sum of the eight corners has a root mean square of 0.2704.
constexpr double kNoiseRms = 0.2704;

/// Bound on the change of the ground's height over a shape and its surroundings, m.
constexpr double kGroundVaries = 2.0;

double corner(std::int64_t x, std::int64_t y, std::int64_t z, std::uint64_t seed, const Eigen::Vector3d& d) {
  const std::uint64_t h = mix64(seed ^ (static_cast<std::uint64_t>(x) * 0x9e3779b97f4a7c15ULL) ^
                                (static_cast<std::uint64_t>(y) * 0xc2b2ae3d27d4eb4fULL) ^
                                (static_cast<std::uint64_t>(z) * 0x165667b19e3779f9ULL));
  switch (h % 12) {
    case 0:
      return d.x() + d.y();
    case 1:
      return d.x() - d.y();
    case 2:
      return -d.x() + d.y();
    case 3:
      return -d.x() - d.y();
    case 4:
      return d.x() + d.z();
    case 5:
      return d.x() - d.z();
    case 6:
      return -d.x() + d.z();
    case 7:
      return -d.x() - d.z();
    case 8:
      return d.y() + d.z();
    case 9:
      return d.y() - d.z();
    case 10:
      return -d.y() + d.z();
    default:
      return -d.y() - d.z();
  }
}

double fade(double t) {
  return t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
}
double mix(double a, double b, double t) {
  return a + t * (b - a);
}

double relief_at(const Roughness& roughness, const Eigen::Vector3d& p, std::uint64_t seed) {
  double sum = 0.0;
  for (std::size_t i = 0; i < roughness.amplitude_m.size(); ++i) {
    sum += roughness.amplitude_m[i] *
           gradient_noise(p / roughness.wavelength_m[i], combine_seeds(seed, static_cast<std::uint64_t>(i)));
  }
  return sum;
}

double largest_relief(const Roughness& roughness) {
  double sum = 0.0;
  for (const double amplitude : roughness.amplitude_m) sum += 4.0 * amplitude;
  return sum;
}

struct Cell3 {
  std::int64_t x, y, z;
  bool operator<(const Cell3& other) const { return std::tie(x, y, z) < std::tie(other.x, other.y, other.z); }
};

/// Distance to the nearest void of the shapes. The relief is computed only near the boundary.
class Field {
 public:
  Field(const std::vector<Shape>& shapes, const std::vector<std::size_t>& chosen, const Ground& ground,
        std::uint64_t seed)
      : shapes_(shapes), chosen_(chosen), ground_(ground), seed_(seed) {}

  double ground(const Eigen::Vector3d& p) const { return ground_(p.x(), p.y()); }

  double smooth(const Eigen::Vector3d& p) const {
    const double level = ground(p);
    double best = std::numeric_limits<double>::infinity();
    for (const std::size_t i : chosen_) best = std::min(best, void_distance(shapes_[i], p, 0.0, level));
    return best;
  }

  double rough(const Eigen::Vector3d& p, double level, double cell) const {
    double best = std::numeric_limits<double>::infinity();
    const Roughness* known = nullptr;
    double relief = 0.0;
    for (const std::size_t i : chosen_) {
      const Shape& shape = shapes_[i];
      double d = void_distance(shape, p, 0.0, level);
      const double margin = largest_relief(*shape.roughness);
      if (d - margin > best) continue;
      if (std::abs(d) < margin + 2.0 * cell) {
        if (shape.roughness != known) {
          known = shape.roughness;
          relief = relief_at(*known, p, seed_);
        }
        d = void_distance(shape, p, relief, level);
      }
      best = std::min(best, d);
    }
    return best;
  }

 private:
  const std::vector<Shape>& shapes_;
  const std::vector<std::size_t>& chosen_;
  const Ground& ground_;
  std::uint64_t seed_;
};

constexpr int kTile = 16;
constexpr int kSide = kTile + 2;  // samples -1 ... kTile

std::size_t sample_index(int x, int y, int z) {
  return static_cast<std::size_t>(((z + 1) * kSide + (y + 1)) * kSide + (x + 1));
}

constexpr std::array<std::array<int, 3>, 3> kAxis{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

struct Crossing {
  Eigen::Vector3d point;
  Eigen::Vector3d normal;
};

/// The surface within one tile by dual contouring (Ju et al. 2002): a vertex in each cell that the boundary
/// crosses, a quadrilateral around each edge that it crosses.
class TileSurface {
 public:
  TileSurface(const Cell3& tile, const Field& field, double cell) : tile_(tile), field_(field), cell_(cell) {}

  TriangleMesh extract() {
    // Far from any boundary there is nothing to extract.
    const double half_diagonal = 0.5 * std::sqrt(3.0) * (kSide - 1) * cell_;
    const double middle = field_.smooth(position(kTile / 2, kTile / 2, kTile / 2));
    if (std::abs(middle) > 1.6 * half_diagonal + 2.0) return {};
    if (!sample()) return {};
    find_crossings();
    vertex_at_.assign(value_.size(), -1);
    add_triangles();
    return std::move(mesh_);
  }

 private:
  [[nodiscard]] Eigen::Vector3d position(int x, int y, int z) const {
    return Eigen::Vector3d(static_cast<double>(tile_.x * kTile + x), static_cast<double>(tile_.y * kTile + y),
                           static_cast<double>(tile_.z * kTile + z)) *
           cell_;
  }
  bool sample();
  void find_crossings();
  [[nodiscard]] Crossing crossing(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double share) const;
  std::uint32_t vertex_of(int x, int y, int z);
  void add_triangles();

  const Cell3& tile_;
  const Field& field_;
  double cell_;
  std::vector<double> value_;
  std::vector<std::int32_t>
      crossing_at_;  ///< Of the edge that begins at a sample along an axis; -1 if it has no crossing.
  std::vector<Crossing> crossings_;
  std::vector<std::int32_t> vertex_at_;  ///< Of each cell; -1 if it has no vertex.
  TriangleMesh mesh_;
};

/// \returns whether there are both void and rock
bool TileSurface::sample() {
  value_.resize(static_cast<std::size_t>(kSide) * kSide * kSide);
  bool any_void = false, any_rock = false;
  std::vector<double> level(static_cast<std::size_t>(kSide) * kSide);
  for (int y = -1; y <= kTile; ++y) {
    for (int x = -1; x <= kTile; ++x) {
      level[static_cast<std::size_t>((y + 1) * kSide + x + 1)] = field_.ground(position(x, y, 0));
    }
  }
  for (int z = -1; z <= kTile; ++z) {
    for (int y = -1; y <= kTile; ++y) {
      for (int x = -1; x <= kTile; ++x) {
        const double d =
            field_.rough(position(x, y, z), level[static_cast<std::size_t>((y + 1) * kSide + x + 1)], cell_);
        value_[sample_index(x, y, z)] = d;
        (d < 0.0 ? any_void : any_rock) = true;
      }
    }
  }
  return any_void && any_rock;
}

void TileSurface::find_crossings() {
  crossing_at_.assign(value_.size() * 3, -1);
  for (int z = -1; z <= kTile; ++z) {
    for (int y = -1; y <= kTile; ++y) {
      for (int x = -1; x <= kTile; ++x) {
        const double here = value_[sample_index(x, y, z)];
        for (std::size_t axis = 0; axis < 3; ++axis) {
          const int x1 = x + kAxis[axis][0], y1 = y + kAxis[axis][1], z1 = z + kAxis[axis][2];
          if (x1 > kTile || y1 > kTile || z1 > kTile) continue;
          const double there = value_[sample_index(x1, y1, z1)];
          if ((here < 0.0) == (there < 0.0)) continue;
          crossing_at_[sample_index(x, y, z) * 3 + axis] = static_cast<std::int32_t>(crossings_.size());
          crossings_.push_back(crossing(position(x, y, z), position(x1, y1, z1), here / (here - there)));
        }
      }
    }
  }
}

Crossing TileSurface::crossing(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double share) const {
  Crossing c;
  c.point = a + (b - a) * share;
  const double at = field_.smooth(c.point);
  const double h = 0.2 * cell_;
  for (int k = 0; k < 3; ++k) {
    c.normal[k] = field_.smooth(c.point + h * Eigen::Vector3d::Unit(k)) - at;
  }
  const double length = c.normal.norm();
  c.normal = length > 1e-9 ? Eigen::Vector3d(c.normal / length) : Eigen::Vector3d::UnitZ();
  return c;
}

/// Vertex of a cell: the point that fits the planes at its crossings best, shifted a little towards the mean
/// of the crossings.
std::uint32_t TileSurface::vertex_of(int x, int y, int z) {
  std::int32_t& known = vertex_at_[sample_index(x, y, z)];
  if (known >= 0) return static_cast<std::uint32_t>(known);
  std::array<const Crossing*, 12> found{};
  std::size_t count = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto& u = kAxis[(axis + 1) % 3];
    const auto& v = kAxis[(axis + 2) % 3];
    for (int i = 0; i < 4; ++i) {
      const int du = i & 1, dv = i >> 1;
      const std::int32_t id = crossing_at_[sample_index(x + du * u[0] + dv * v[0], y + du * u[1] + dv * v[1],
                                                        z + du * u[2] + dv * v[2]) *
                                               3 +
                                           axis];
      if (id >= 0) found[count++] = &crossings_[static_cast<std::size_t>(id)];
    }
  }
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < count; ++i) mean += found[i]->point;
  mean /= static_cast<double>(std::max<std::size_t>(count, 1));
  Eigen::Matrix3d A = 0.1 * Eigen::Matrix3d::Identity();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d& n = found[i]->normal;
    A += n * n.transpose();
    b += n * n.dot(found[i]->point - mean);
  }
  const Eigen::Vector3d low = position(x, y, z), high = position(x + 1, y + 1, z + 1);
  const Eigen::Vector3d vertex = (mean + A.ldlt().solve(b)).cwiseMax(low).cwiseMin(high);
  known = static_cast<std::int32_t>(mesh_.vertices.size());
  mesh_.vertices.push_back(vertex.cast<float>());
  return static_cast<std::uint32_t>(known);
}

void TileSurface::add_triangles() {
  for (int z = 0; z < kTile; ++z) {
    for (int y = 0; y < kTile; ++y) {
      for (int x = 0; x < kTile; ++x) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
          if (crossing_at_[sample_index(x, y, z) * 3 + axis] < 0) continue;
          const auto& u = kAxis[(axis + 1) % 3];
          const auto& v = kAxis[(axis + 2) % 3];
          const std::uint32_t c00 = vertex_of(x - u[0] - v[0], y - u[1] - v[1], z - u[2] - v[2]);
          const std::uint32_t c10 = vertex_of(x - v[0], y - v[1], z - v[2]);
          const std::uint32_t c01 = vertex_of(x - u[0], y - u[1], z - u[2]);
          const std::uint32_t c11 = vertex_of(x, y, z);
          mesh_.triangles.push_back({c00, c10, c11});
          mesh_.triangles.push_back({c00, c11, c01});
        }
      }
    }
  }
}

struct Box3 {
  Eigen::Vector3d low, high;
};

Box3 bounds(const Shape& s) {
  const double reach = s.kind == Shape::Kind::kBox ? std::hypot(s.half_width, s.half_length) : s.half_width;
  Box3 box{s.a.cwiseMin(s.b), s.a.cwiseMax(s.b)};
  if (s.kind == Shape::Kind::kBox) box = {s.a, s.a};
  box.low -= Eigen::Vector3d(reach, reach, 0.0);
  box.high += Eigen::Vector3d(reach, reach, s.height);
  return box;
}

}  // namespace

double gradient_noise(const Eigen::Vector3d& p, std::uint64_t seed) {
  const Eigen::Vector3d base(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
  const Eigen::Vector3d d = p - base;
  const auto x = static_cast<std::int64_t>(base.x()), y = static_cast<std::int64_t>(base.y()),
             z = static_cast<std::int64_t>(base.z());
  const auto at = [&](int i, int j, int k) {
    return corner(x + i, y + j, z + k, seed, d - Eigen::Vector3d(i, j, k));
  };
  const double u = fade(d.x()), v = fade(d.y()), w = fade(d.z());
  const double low = mix(mix(at(0, 0, 0), at(1, 0, 0), u), mix(at(0, 1, 0), at(1, 1, 0), u), v);
  const double high = mix(mix(at(0, 0, 1), at(1, 0, 1), u), mix(at(0, 1, 1), at(1, 1, 1), u), v);
  return mix(low, high, w) / kNoiseRms;
}

double void_distance(const Shape& s, const Eigen::Vector3d& p, double relief, double ground) {
  const double floor_relief = s.roughness->floor_share * relief;
  if (s.kind == Shape::Kind::kBox) {
    const double c = std::cos(s.yaw), n = std::sin(s.yaw);
    const double dx = p.x() - s.a.x(), dy = p.y() - s.a.y(), v = p.z() - s.a.z();
    const double x = std::abs(c * dx + n * dy) - s.half_width, y = std::abs(c * dy - n * dx) - s.half_length;
    return std::max({x + relief, y + relief, v - s.height + relief, -v + floor_relief});
  }
  const Eigen::Vector2d along = (s.b - s.a).head<2>();
  const Eigen::Vector2d to = (p - s.a).head<2>();
  const double length2 = along.squaredNorm();
  const double t = length2 > 0.0 ? std::clamp(to.dot(along) / length2, 0.0, 1.0) : 0.0;
  const double u = (to - t * along).norm();
  const double v = p.z() - (s.grounded ? ground : s.a.z() + t * (s.b.z() - s.a.z()));
  if (s.kind == Shape::Kind::kTube) {
    const double half_height =
        0.6 * s.height;  // the centre is above the floor, and the floor cuts the ellipse
    const double y = (v - 0.4 * s.height) / half_height * s.half_width;
    const double shrink = std::min(1.0, half_height / s.half_width);
    return std::max((std::hypot(u, y) - s.half_width) * shrink + relief, -v + floor_relief);
  }
  const double share = std::min(u / s.half_width, 1.2);
  return std::max(
      {u - s.half_width + relief, v - s.height + s.roof_sag * share * share + relief, -v + floor_relief});
}

TriangleMesh extract_surface(const std::vector<Shape>& shapes, const Ground& ground, double cell,
                             std::uint64_t seed, int threads, const StopToken& stop) {
  // Collects for each tile the shapes that can reach it. The margin is wide enough that neighbouring tiles
  // agree on the samples that they share.
  std::map<Cell3, std::vector<std::size_t>> near;
  const double side = kTile * cell;
  for (std::size_t i = 0; i < shapes.size(); ++i) {
    const Box3 box = bounds(shapes[i]);
    // Uneven ground may leave the bounding box by some metres.
    const double margin = largest_relief(*shapes[i].roughness) + 4.0 * cell;
    const double lift = shapes[i].grounded ? kGroundVaries : 0.0;
    const auto tile_of = [&](double x) { return static_cast<std::int64_t>(std::floor(x / side)); };
    for (auto x = tile_of(box.low.x() - margin); x <= tile_of(box.high.x() + margin); ++x) {
      for (auto y = tile_of(box.low.y() - margin); y <= tile_of(box.high.y() + margin); ++y) {
        for (auto z = tile_of(box.low.z() - margin - lift); z <= tile_of(box.high.z() + margin + lift); ++z) {
          near[{x, y, z}].push_back(i);
        }
      }
    }
  }
  std::vector<std::pair<Cell3, const std::vector<std::size_t>*>> tiles;
  tiles.reserve(near.size());
  for (const auto& [tile, list] : near) tiles.emplace_back(tile, &list);

  std::vector<TriangleMesh> parts(tiles.size());
  ThreadPool pool(threads);
  pool.for_each(tiles.size(), [&](std::size_t i) {
    if (stop.stop_requested()) return;
    parts[i] = TileSurface(tiles[i].first, Field(shapes, *tiles[i].second, ground, seed), cell).extract();
  });

  TriangleMesh mesh;
  for (TriangleMesh& part : parts) {
    const auto offset = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), part.vertices.begin(), part.vertices.end());
    for (const auto& t : part.triangles) {
      mesh.triangles.push_back({t[0] + offset, t[1] + offset, t[2] + offset});
    }
    part = {};
  }
  return mesh;
}

}  // namespace loopwise::simulation_detail
