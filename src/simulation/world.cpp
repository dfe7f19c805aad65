// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/world.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <string>
#include <utility>

#include <Eigen/Geometry>

#include <loopwise/core/random.hpp>

#include "parameters.hpp"
#include "surface.hpp"

namespace loopwise {
namespace {

namespace parameters = simulation_parameters;
using parameters::Range;
using simulation_detail::gradient_noise;
using simulation_detail::Shape;
using PlaceKind = RouteGraph::PlaceKind;

constexpr double kPi = 3.14159265358979323846;
constexpr double kWallClearance = 0.9;  ///< From a robot's centre to a wall, at least, m.

double draw(Rng& rng, const Range& range) {
  return rng.uniform(range.low, range.high);
}

/// How a passage is cut.
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

void add_quad(TriangleMesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
  mesh.triangles.push_back({a, b, c});
  mesh.triangles.push_back({a, c, d});
}

/// Collects holes, ways and things; things are set last, where no robot drives.
class Builder {
 public:
  explicit Builder(std::uint64_t seed) : rng_(combine_seeds(seed, 1)), seed_(seed) {}

  Rng& rng() { return rng_; }
  /// \param level_south_of the ground is level where y is smaller, for buildings.
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
    // No robot starts on a slope of the whole seam: the undulation fades in over the first 30 m.
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

  /// Cuts a passage between two places that winds by the style's meander, and makes it a way.
  void passage(std::size_t from, std::size_t to, const Style& style) {
    const Eigen::Vector3d a = at(from), b = at(to);
    const double length = (b - a).head<2>().norm();
    const int pieces = std::max(1, static_cast<int>(std::lround(length / 5.0)));
    const Eigen::Vector2d side = Eigen::Vector2d(a.y() - b.y(), b.x() - a.x()) / std::max(length, 1e-9);
    const double phase = rng_.uniform(0.0, 1000.0);
    std::vector<Eigen::Vector3d> path{a};
    for (int i = 1; i < pieces; ++i) {
      const double t = static_cast<double>(i) / pieces;
      Eigen::Vector3d p = a + t * (b - a);
      const double swing = style.meander * std::min(1.0, 4.0 * std::min(t, 1.0 - t)) *
                           gradient_noise(Eigen::Vector3d(phase + t * length / 18.0, 0.5, 0.5), seed_);
      p.head<2>() += swing * side;
      p.z() = ground(p.x(), p.y());
      path.push_back(p);
    }
    path.push_back(b);
    cut(path, style);
    way(from, to, std::move(path), std::max(0.15, style.half_width - style.clearance), style.corridor);
  }

  /// The hole alone.
  void cut(const std::vector<Eigen::Vector3d>& path, const Style& style) {
    for (std::size_t i = 1; i < path.size(); ++i) {
      Shape s;
      s.kind = style.kind;
      s.a = path[i - 1];
      s.b = path[i];
      const double change = 1.0 + style.size_change * rng_.uniform(-1.0, 1.0);
      s.half_width = style.half_width * change;
      const double lift = 1.0 + style.size_change * rng_.uniform(-0.5, 1.0);
      s.height = style.height * (style.kind == Shape::Kind::kTube ? lift : 1.0);
      s.grounded = undulation_m_ > 0.0 && style.grounded;
      s.roof_sag = style.roof_sag;
      s.roughness = style.roughness;
      shapes_.push_back(s);
    }
  }
  void add(const Shape& shape) { shapes_.push_back(shape); }

  /// The way alone.
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

  /// A box on the floor, a post or drum, or a pipe; left out where robots drive.
  void box(const Eigen::Vector3d& floor, double length, double width, double height, double yaw) {
    box(floor, length, width, height, yaw, 0.5 * std::hypot(length, width));
  }
  /// \param reach how far it reaches towards the way.
  void box(const Eigen::Vector3d& floor, double length, double width, double height, double yaw,
           double reach) {
    things_.push_back([=](TriangleMesh& mesh) {
      const Eigen::Vector3d u = 0.5 * length * Eigen::Vector3d(std::cos(yaw), std::sin(yaw), 0.0);
      const Eigen::Vector3d v = 0.5 * width * Eigen::Vector3d(-std::sin(yaw), std::cos(yaw), 0.0);
      add_box(mesh, floor, u, v, height);
    });
    foot_.push_back({floor, reach});
  }
  void post(const Eigen::Vector3d& floor, double radius, double height) {
    things_.push_back([=](TriangleMesh& mesh) {
      add_prism(mesh, floor, floor + Eigen::Vector3d(0.0, 0.0, height), radius, 10);
    });
    foot_.push_back({floor, radius});
  }
  /// Overhead or along a wall: never in the way.
  void pipe(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double radius) {
    things_.push_back([=](TriangleMesh& mesh) { add_prism(mesh, a, b, radius, 8); });
    foot_.push_back({a, -1.0});
  }
  void step(const Eigen::Vector3d& floor, const Eigen::Vector3d& u, const Eigen::Vector3d& v, double height) {
    things_.push_back([=](TriangleMesh& mesh) { add_box(mesh, floor, u, v, height); });
    foot_.push_back({floor, -1.0});
  }

  World build(WorldKind kind, double cell, int threads, const StopToken& stop) {
    World world;
    world.kind = kind;
    mark_dead_ends();
    world.mesh = simulation_detail::extract_surface(
        shapes_, [this](double x, double y) { return ground(x, y); }, cell, combine_seeds(seed_, 3), threads,
        stop);
    for (std::size_t i = 0; i < things_.size(); ++i) {
      if (foot_[i].radius < 0.0 || out_of_the_way(foot_[i])) things_[i](world.mesh);
    }
    world.routes = routes_;
    return world;
  }

  [[nodiscard]] const RouteGraph& routes() const { return routes_; }

 private:
  struct Foot {
    Eigen::Vector3d centre;
    double radius;
  };

  static void add_box(TriangleMesh& mesh, const Eigen::Vector3d& floor, const Eigen::Vector3d& u,
                      const Eigen::Vector3d& v, double height) {
    const auto base = static_cast<std::uint32_t>(mesh.vertices.size());
    for (int k = 0; k < 8; ++k) {
      Eigen::Vector3d p =
          floor + ((k & 1) != 0 ? u : Eigen::Vector3d(-u)) + ((k & 2) != 0 ? v : Eigen::Vector3d(-v));
      p.z() += (k & 4) != 0 ? height : -0.3;  // feet reach into the rough floor
      mesh.vertices.push_back(p.cast<float>());
    }
    add_quad(mesh, base + 4, base + 5, base + 7, base + 6);
    add_quad(mesh, base, base + 1, base + 5, base + 4);
    add_quad(mesh, base + 2, base + 3, base + 7, base + 6);
    add_quad(mesh, base, base + 2, base + 6, base + 4);
    add_quad(mesh, base + 1, base + 3, base + 7, base + 5);
  }

  static void add_prism(TriangleMesh& mesh, const Eigen::Vector3d& a, const Eigen::Vector3d& b, double radius,
                        std::uint32_t sides) {
    const Eigen::Vector3d axis = (b - a).normalized();
    const Eigen::Vector3d u = axis.unitOrthogonal() * radius, v = axis.cross(u);
    const auto base = static_cast<std::uint32_t>(mesh.vertices.size());
    for (std::uint32_t k = 0; k < sides; ++k) {
      const double angle = 2.0 * kPi * k / sides;
      const Eigen::Vector3d rim = std::cos(angle) * u + std::sin(angle) * v;
      mesh.vertices.push_back((a + rim).cast<float>());
      mesh.vertices.push_back((b + rim).cast<float>());
    }
    mesh.vertices.push_back(b.cast<float>());
    for (std::uint32_t k = 0; k < sides; ++k) {
      const std::uint32_t i = base + 2 * k, j = base + 2 * ((k + 1) % sides);
      add_quad(mesh, i, j, j + 1, i + 1);
      mesh.triangles.push_back({i + 1, j + 1, base + 2 * sides});
    }
  }

  [[nodiscard]] bool out_of_the_way(const Foot& foot) const {
    for (const auto& p : routes_.passages) {
      const double keep = p.half_width_m + 0.55 + foot.radius;
      for (std::size_t i = 1; i < p.path.size(); ++i) {
        const Eigen::Vector3d& a = p.path[i - 1];
        const Eigen::Vector3d& b = p.path[i];
        if (std::min(a.x(), b.x()) - keep > foot.centre.x() ||
            std::max(a.x(), b.x()) + keep < foot.centre.x() || std::abs(a.z() - foot.centre.z()) > 3.0) {
          continue;
        }
        const double t =
            std::clamp((foot.centre - a).dot(b - a) / std::max((b - a).squaredNorm(), 1e-12), 0.0, 1.0);
        if ((a + t * (b - a) - foot.centre).head<2>().norm() < keep) return false;
      }
    }
    return true;
  }

  void mark_dead_ends() {
    std::vector<int> degree(routes_.places.size(), 0);
    for (const auto& p : routes_.passages) {
      ++degree[p.from];
      ++degree[p.to];
    }
    for (std::size_t i = 0; i < degree.size(); ++i) {
      auto& kind = routes_.places[i].kind;
      if (degree[i] == 1 && kind == PlaceKind::kJunction) kind = PlaceKind::kDeadEnd;
    }
  }

  Rng rng_;
  std::uint64_t seed_;
  double undulation_m_ = 0.0;
  double level_south_of_ = 0.0;
  std::vector<Shape> shapes_;
  RouteGraph routes_;
  std::vector<std::function<void(TriangleMesh&)>> things_;
  std::vector<Foot> foot_;
};

// ---- coal mine

Style entry_style(Builder& builder) {
  Style style;
  style.half_width = 0.5 * draw(builder.rng(), parameters::kTunnel.width_m);
  style.height = draw(builder.rng(), parameters::kTunnel.height_m);
  style.roof_sag = parameters::kTunnel.roof_sag_m;
  style.meander = parameters::kTunnel.meander_m;
  style.size_change = 0.03;
  style.roughness = &parameters::kCoal;
  style.grounded = true;
  style.clearance = parameters::kTunnel.clearance_m;
  return style;
}

/// Parallel entries along `along` from `start`, `across` apart, joined by cross-cuts. `first` holds the
/// places where the entries begin (made if empty). \returns the places at the ends.
std::vector<std::size_t> parallel_entries(Builder& builder, const Eigen::Vector2d& start,
                                          const Eigen::Vector2d& along, const Eigen::Vector2d& across,
                                          std::vector<std::size_t> first, const std::vector<double>& cuts,
                                          std::size_t count,
                                          std::vector<std::vector<std::size_t>>* places = nullptr) {
  std::vector<Style> styles;
  for (std::size_t e = 0; e < count; ++e) styles.push_back(entry_style(builder));
  std::vector<std::size_t> last = std::move(first);
  for (const double s : cuts) {
    std::vector<std::size_t> here;
    for (std::size_t e = 0; e < count; ++e) {
      const Eigen::Vector2d p = start + s * along + static_cast<double>(e) * across;
      here.push_back(builder.place(p.x(), p.y()));
      if (e < last.size()) builder.passage(last[e], here[e], styles[e]);
    }
    for (std::size_t e = 1; e < count; ++e) builder.passage(here[e - 1], here[e], entry_style(builder));
    if (places) places->push_back(here);
    last = here;
  }
  return last;
}

/// Distances along an entry at which cross-cuts leave it; the last is `length`.
std::vector<double> cross_cuts(Rng& rng, double length) {
  const auto& t = parameters::kTunnel;
  std::vector<double> cuts;
  double s = 0.0;
  while (true) {
    s += draw(rng, t.cross_cut_spacing_m);
    if (s > length - 0.6 * t.cross_cut_spacing_m.low) break;
    cuts.push_back(s);
  }
  cuts.push_back(length);
  return cuts;
}

/// The entries go on for some metres beyond the last cross-cut: faces where the seam is worked.
void add_faces(Builder& builder, const std::vector<std::size_t>& ends, const Eigen::Vector2d& along) {
  for (const std::size_t end : ends) {
    const Eigen::Vector2d p =
        builder.at(end).head<2>() + draw(builder.rng(), parameters::kTunnel.face_m) * along;
    builder.passage(end, builder.place(p.x(), p.y()), entry_style(builder));
  }
}

void furnish_entries(Builder& builder) {
  const auto& t = parameters::kTunnel;
  Rng& rng = builder.rng();
  const auto passages = builder.routes().passages;
  for (const auto& p : passages) {
    const double side = rng.uniform() < 0.5 ? -1.0 : 1.0;
    const double wall = p.half_width_m + t.clearance_m;
    const bool has_pipe = p.length_m > 20.0 && rng.uniform() < 0.5;
    for (std::size_t i = 1; i < p.path.size(); ++i) {
      const Eigen::Vector3d a = p.path[i - 1], b = p.path[i], d = b - a;
      const Eigen::Vector3d left = Eigen::Vector3d(-d.y(), d.x(), 0.0).normalized();
      const Eigen::Vector3d up(0.0, 0.0, 1.65);
      if (has_pipe) {
        builder.pipe(a + side * (wall - 0.22) * left + up, b + side * (wall - 0.22) * left + up,
                     t.pipe_radius_m);
      }
      if (rng.uniform() < d.norm() / t.prop_spacing_m) {
        const double hand = rng.uniform() < 0.5 ? -1.0 : 1.0;
        builder.post(a + rng.uniform() * d + hand * (wall - 0.2) * left, rng.uniform(0.07, 0.12), 2.6);
      }
      if (rng.uniform() < 0.25 * d.norm() / t.prop_spacing_m) {
        const double hand = rng.uniform() < 0.5 ? -1.0 : 1.0;
        builder.box(a + rng.uniform() * d + hand * (wall - 0.2) * left, rng.uniform(0.3, 1.2),
                    rng.uniform(0.3, 0.5), rng.uniform(0.2, 1.0),
                    std::atan2(d.y(), d.x()) + rng.uniform(-0.3, 0.3));
      }
    }
  }
}

void plan_tunnel(Builder& builder, double target) {
  const auto& t = parameters::kTunnel;
  Rng& rng = builder.rng();
  builder.set_undulation(t.undulation_m);
  const double spacing = t.entry_spacing_m;
  const std::size_t gate = builder.place(0.0, 0.0);
  const Eigen::Vector2d start(8.0, 0.0), along(1.0, 0.0), across(0.0, spacing);
  if (target < 400.0) {
    const double length = std::max(12.0, (target - 8.0 - spacing) / (2.0 + spacing / 40.0));
    std::vector<double> cuts{0.0};
    for (const double s : cross_cuts(rng, length)) cuts.push_back(s);
    std::vector<std::vector<std::size_t>> places;
    parallel_entries(builder, start, along, across, {}, cuts, 2, &places);
    builder.passage(gate, places[0][0], entry_style(builder));
    furnish_entries(builder);
    return;
  }
  // Spots on the mains where a pair of entries, a panel, leaves on either side.
  const auto spots = static_cast<std::size_t>(std::max(1L, std::lround(target / 750.0)));
  std::vector<double> cuts{0.0};
  std::vector<std::size_t> panel_at;
  double s = 0.0;
  for (std::size_t i = 0; i < spots; ++i) {
    s += draw(rng, t.cross_cut_spacing_m);
    panel_at.push_back(cuts.size());
    cuts.push_back(s);
    s += spacing;
    cuts.push_back(s);
  }
  cuts.push_back(s + draw(rng, t.cross_cut_spacing_m));
  std::vector<std::vector<std::size_t>> mains;
  parallel_entries(builder, start, along, across, {}, cuts, 3, &mains);
  builder.passage(gate, mains[0][0], entry_style(builder));
  add_faces(builder, mains.back(), along);

  const double left = std::max(0.0, target - builder.passage_length());
  const double mean_length =
      std::max(40.0, left / (2.0 * static_cast<double>(spots)) / (2.0 + spacing / 40.0));
  for (const bool north : {true, false}) {
    std::vector<std::size_t> neighbour;  // far ends of the panel before
    double neighbour_length = 0.0;
    for (const std::size_t spot : panel_at) {
      const std::size_t e = north ? 2 : 0;
      const bool joined = !neighbour.empty() && rng.uniform() < t.bleeder_share;
      const double length = joined ? neighbour_length : mean_length * rng.uniform(0.7, 1.3);
      const std::vector<std::size_t> first{mains[spot][e], mains[spot + 1][e]};
      const Eigen::Vector2d corner = builder.at(first[0]).head<2>();
      const Eigen::Vector2d way(0.0, north ? 1.0 : -1.0);
      const std::vector<std::size_t> ends = parallel_entries(
          builder, corner, way, Eigen::Vector2d(spacing, 0.0), first, cross_cuts(rng, length), 2);
      if (joined) builder.passage(neighbour[1], ends[0], entry_style(builder));
      add_faces(builder, ends, way);
      neighbour = ends;
      neighbour_length = length;
    }
  }
  furnish_entries(builder);
}

// ---- lattices: limestone mine and cave

struct Lattice {
  Eigen::Vector2d origin;
  double pitch_x, pitch_y;
  double jitter;
  double closed_share;
  int j_low, j_high;  ///< Rows that exist.
};

/// Grows ways over a jittered lattice from (0, 0) outwards until they are `target` metres long in sum.
template <class MakeStyle>
std::map<std::pair<int, int>, std::size_t> grow_lattice(Builder& builder, const Lattice& lattice,
                                                        double target, MakeStyle&& make_style) {
  Rng& rng = builder.rng();
  const double pitch = std::min(lattice.pitch_x, lattice.pitch_y);
  const int reach = std::max(2, static_cast<int>(std::ceil(1.6 * std::sqrt(target / (2.0 * pitch))) + 2.0));
  std::vector<std::pair<double, std::pair<int, int>>> order;
  for (int i = 0; i <= 2 * reach; ++i) {
    for (int j = std::max(-reach, lattice.j_low); j <= std::min(reach, lattice.j_high); ++j) {
      // A column is about as easy to open as a row; chance makes the outline irregular.
      order.push_back({std::hypot(0.8 * i, j) * (1.0 + 0.35 * rng.uniform()), {i, j}});
    }
  }
  std::sort(order.begin(), order.end());
  order.erase(
      std::remove_if(order.begin(), order.end(), [](const auto& o) { return o.second == std::pair(0, 0); }),
      order.end());
  std::map<std::pair<int, int>, std::size_t> places;
  const auto make_place = [&](int i, int j) {
    const bool first = i == 0 && j == 0;
    const double dx = first ? 0.0 : lattice.jitter * rng.uniform(-1.0, 1.0);
    const double dy = first ? 0.0 : lattice.jitter * rng.uniform(-1.0, 1.0);
    return places[{i, j}] = builder.place(lattice.origin.x() + i * lattice.pitch_x + dx,
                                          lattice.origin.y() + j * lattice.pitch_y + dy);
  };
  make_place(0, 0);
  const double before = builder.passage_length();
  std::vector<std::pair<double, std::pair<int, int>>> waiting = order;
  while (builder.passage_length() - before < target && !waiting.empty()) {
    // The first in order that touches what is open.
    bool opened = false;
    for (std::size_t w = 0; w < waiting.size(); ++w) {
      const auto [i, j] = waiting[w].second;
      std::vector<std::size_t> neighbours;
      for (const auto& [di, dj] : {std::pair(-1, 0), std::pair(1, 0), std::pair(0, -1), std::pair(0, 1)}) {
        const auto found = places.find({i + di, j + dj});
        if (found != places.end()) neighbours.push_back(found->second);
      }
      if (neighbours.empty()) continue;
      const std::size_t here = make_place(i, j);
      rng.shuffle(neighbours);
      for (std::size_t n = 0; n < neighbours.size(); ++n) {
        if (n > 0 && rng.uniform() < lattice.closed_share) continue;
        builder.passage(neighbours[n], here, make_style());
      }
      waiting.erase(waiting.begin() + static_cast<std::ptrdiff_t>(w));
      opened = true;
      break;
    }
    if (!opened) break;
  }
  return places;
}

void plan_mine(Builder& builder, double target) {
  const auto& m = parameters::kMine;
  Rng& rng = builder.rng();
  builder.set_undulation(m.undulation_m);
  const auto style = [&] {
    Style s;
    s.half_width = 0.5 * draw(rng, m.width_m);
    s.height = draw(rng, m.height_m);
    s.roof_sag = m.roof_sag_m;
    s.size_change = 0.06;
    s.meander = 0.5;
    s.roughness = &parameters::kLimestone;
    s.grounded = true;
    s.clearance = m.clearance_m;
    return s;
  };
  const std::size_t gate = builder.place(0.0, 0.0);
  Lattice lattice{{22.0, 0.0},
                  draw(rng, m.pillar_pitch_m),
                  draw(rng, m.pillar_pitch_m),
                  m.pillar_jitter_m,
                  m.unmined_share,
                  -1000,
                  1000};
  const auto places = grow_lattice(builder, lattice, target - 22.0, style);
  builder.passage(gate, places.at({0, 0}), style());
  const auto passages = builder.routes().passages;
  for (const auto& p : passages) {
    const double wall = p.half_width_m + m.clearance_m;
    for (std::size_t i = 1; i < p.path.size(); ++i) {
      const Eigen::Vector3d a = p.path[i - 1], d = p.path[i] - a;
      const Eigen::Vector3d left = Eigen::Vector3d(-d.y(), d.x(), 0.0).normalized();
      // Rubble that fell from the ribs lies at their feet, now and then a machine stands aside.
      if (rng.uniform() < d.norm() / m.rubble_spacing_m) {
        const double hand = rng.uniform() < 0.5 ? -1.0 : 1.0;
        const double size = rng.uniform(0.4, 1.6);
        builder.box(a + rng.uniform() * d + hand * (wall - 0.3 * size) * left, size,
                    size * rng.uniform(0.5, 1.0), size * rng.uniform(0.4, 0.9), rng.uniform(0.0, kPi));
      }
      if (rng.uniform() < 0.12 * d.norm() / m.rubble_spacing_m) {
        const double hand = rng.uniform() < 0.5 ? -1.0 : 1.0;
        const double width = rng.uniform(1.8, 2.4);
        builder.box(a + hand * (wall - 0.5 * width - 0.3) * left, rng.uniform(3.0, 6.0), width,
                    rng.uniform(1.5, 2.6), std::atan2(d.y(), d.x()) + rng.uniform(-0.1, 0.1), 0.5 * width);
      }
    }
  }
}

std::map<std::pair<int, int>, std::size_t> plan_cave(Builder& builder, const Eigen::Vector2d& origin,
                                                     double target, int j_low, int j_high) {
  const auto& c = parameters::kCaveShape;
  Rng& rng = builder.rng();
  const auto style = [&] {
    Style s;
    s.kind = Shape::Kind::kTube;
    s.half_width = 0.5 * draw(rng, c.width_m);
    s.height = draw(rng, c.height_m);
    s.size_change = 0.22;
    s.meander = c.meander_m;
    s.roughness = &parameters::kCave;
    s.grounded = true;
    return s;
  };
  const Lattice lattice{origin, draw(rng, c.pitch_m), draw(rng, c.pitch_m), c.jitter_m, c.closed_share, j_low,
                        j_high};
  auto places = grow_lattice(builder, lattice, target, style);
  for (const auto& [index, place] : places) {
    if (index != std::pair(0, 0) && rng.uniform() < 0.5) continue;
    Shape chamber;
    chamber.kind = Shape::Kind::kTube;
    chamber.a = chamber.b = builder.at(place);
    chamber.half_width = draw(rng, c.chamber_radius_m);
    chamber.height = chamber.half_width * rng.uniform(0.7, 1.1);
    chamber.roughness = &parameters::kCave;
    chamber.grounded = true;
    builder.add(chamber);
    for (int k = 0; k < 4; ++k) {
      const double angle = rng.uniform(0.0, 2.0 * kPi), size = rng.uniform(0.4, 1.3);
      const Eigen::Vector3d aside(std::cos(angle), std::sin(angle), 0.0);
      builder.box(chamber.a + 0.75 * chamber.half_width * aside, size, size * rng.uniform(0.5, 1.0),
                  size * 0.7, angle);
    }
  }
  return places;
}

// ---- power plant

/// One building from its south-west corner on: corridors on a grid, rooms and halls between, `floors`
/// storeys. \returns the corridor places of the ground floor by (column, row).
std::map<std::pair<int, int>, std::size_t> plan_building(Builder& builder, const Eigen::Vector2d& corner,
                                                         int columns, int rows, int floors) {
  const auto& u = parameters::kUrban;
  Rng& rng = builder.rng();
  std::vector<double> xs{corner.x()}, ys{corner.y()};
  for (int i = 0; i < columns; ++i) xs.push_back(xs.back() + draw(rng, u.block_x_m));
  for (int j = 0; j < rows; ++j) ys.push_back(ys.back() + draw(rng, u.block_y_m));
  std::vector<double> width_x, width_y;  // of the corridors along y and along x
  for (int i = 0; i <= columns; ++i) width_x.push_back(draw(rng, u.corridor_width_m));
  for (int j = 0; j <= rows; ++j) width_y.push_back(draw(rng, u.corridor_width_m));

  const auto corridor = [&](double width) {
    Style s;
    s.half_width = 0.5 * width;
    s.height = u.room_height_m - 0.4;
    s.roughness = &parameters::kConcrete;
    return s;
  };
  const auto box_shape = [&](const Eigen::Vector3d& low, double sx, double sy, double height) {
    Shape s;
    s.kind = Shape::Kind::kBox;
    s.a = low + Eigen::Vector3d(0.5 * sx, 0.5 * sy, 0.0);
    s.half_width = 0.5 * sx;
    s.half_length = 0.5 * sy;
    s.height = height;
    s.roughness = &parameters::kConcrete;
    return s;
  };
  const auto flat_passage = [&](std::size_t from, std::size_t to, double width) {
    const std::vector<Eigen::Vector3d> path{builder.at(from), builder.at(to)};
    builder.cut(path, corridor(width));
    builder.way(from, to, path, std::max(0.15, 0.5 * width - kWallClearance), true);
  };
  const auto doorway = [&](const Eigen::Vector3d& a, const Eigen::Vector3d& b, double width) {
    Style s = corridor(width);
    s.height = u.door_height_m;
    builder.cut({a, b}, s);
  };
  const auto furnish_room = [&](const Eigen::Vector3d& low, double sx, double sy) {
    const int count = static_cast<int>(sx * sy / 9.0);
    for (int k = 0; k < count; ++k) {
      const double length = rng.uniform(0.6, 1.8), depth = rng.uniform(0.4, 0.8),
                   height = rng.uniform(0.7, 2.0);
      const bool along_x = rng.uniform() < 0.5, far = rng.uniform() < 0.5;
      Eigen::Vector3d p = low;
      if (along_x) {
        p += Eigen::Vector3d(rng.uniform(0.1, 0.9) * sx, far ? sy - 0.5 * depth : 0.5 * depth, 0.0);
      } else {
        p += Eigen::Vector3d(far ? sx - 0.5 * depth : 0.5 * depth, rng.uniform(0.1, 0.9) * sy, 0.0);
      }
      builder.box(p, length, depth, height, along_x ? 0.0 : 0.5 * kPi);
    }
  };
  const auto furnish_hall = [&](const Eigen::Vector3d& low, double sx, double sy, double height) {
    const double pitch = draw(rng, u.column_spacing_m);
    double x = 0.5 * pitch;
    while (x < sx) {
      for (const double y : {0.12 * sy, 0.88 * sy})
        builder.post(low + Eigen::Vector3d(x, y, 0.0), 0.25, height + 0.3);
      x += pitch;
    }
    const int machines = 2 + static_cast<int>(rng.below(3));
    for (int k = 0; k < machines; ++k) {
      const Eigen::Vector3d p =
          low + Eigen::Vector3d(rng.uniform(0.3, 0.7) * sx, rng.uniform(0.35, 0.65) * sy, 0.0);
      if (rng.uniform() < 0.5) {
        builder.post(p, rng.uniform(0.6, 1.3), rng.uniform(1.5, 4.0));
      } else {
        builder.box(p, rng.uniform(1.5, 4.0), rng.uniform(1.0, 1.8), rng.uniform(1.0, 2.5),
                    0.5 * kPi * (rng.uniform() < 0.5));
      }
    }
    for (const double y : {0.3 * sy, 0.7 * sy}) {
      builder.pipe(low + Eigen::Vector3d(0.0, y, 0.7 * height), low + Eigen::Vector3d(sx, y, 0.7 * height),
                   0.2);
    }
    furnish_room(low, sx, sy);
  };

  std::map<std::pair<int, int>, std::size_t> ground_floor, upper_floor;
  std::vector<char> tall(static_cast<std::size_t>(columns * rows), 0);
  for (int floor = 0; floor < floors; ++floor) {
    const double z = floor * u.storey_m;
    auto& junctions = floor == 0 ? ground_floor : upper_floor;
    for (int i = 0; i <= columns; ++i) {
      for (int j = 0; j <= rows; ++j) {
        junctions[{i, j}] = builder.place(
            Eigen::Vector3d(xs[static_cast<std::size_t>(i)], ys[static_cast<std::size_t>(j)], z));
      }
    }
    // Doors on the corridors along x, by (column, row of the corridor): x of the door and its place.
    std::map<std::pair<int, int>, std::vector<std::pair<double, std::size_t>>> doors;
    const auto door_place = [&](int i, int j, double x) {
      const std::size_t place = builder.place(Eigen::Vector3d(x, ys[static_cast<std::size_t>(j)], z));
      doors[{i, j}].emplace_back(x, place);
      return place;
    };
    for (int i = 0; i < columns; ++i) {
      for (int j = 0; j < rows; ++j) {
        const auto ci = static_cast<std::size_t>(i), cj = static_cast<std::size_t>(j);
        const Eigen::Vector3d low(xs[ci] + 0.5 * width_x[ci] + u.wall_m,
                                  ys[cj] + 0.5 * width_y[cj] + u.wall_m, z);
        const Eigen::Vector3d high(xs[ci + 1] - 0.5 * width_x[ci + 1] - u.wall_m,
                                   ys[cj + 1] - 0.5 * width_y[cj + 1] - u.wall_m, z);
        const double sx = high.x() - low.x(), sy = high.y() - low.y();
        char& is_tall = tall[static_cast<std::size_t>(j * columns + i)];
        if (floor > 0 && is_tall) continue;
        // From the door in the wall to the corridor behind it, on the side `north` of the block.
        const auto open_door = [&](double x, bool north, double width, std::size_t room,
                                   const Eigen::Vector3d& inside) {
          const std::size_t place = door_place(i, north ? j + 1 : j, x);
          const Eigen::Vector3d sill(x, north ? high.y() - 0.7 : low.y() + 0.7, z);
          doorway(builder.at(place), sill, width);
          builder.way(place, room, {builder.at(place), sill, inside}, 0.15, false);
        };
        if (rng.uniform() < u.hall_share) {
          const double height = floors > 1 && floor == 0 ? u.hall_height_m : u.room_height_m;
          is_tall = floors > 1 && floor == 0 ? 1 : 0;
          builder.add(box_shape(low, sx, sy, height));
          std::vector<std::size_t> ring;
          for (const auto& [fx, fy] :
               {std::pair(0.2, 0.25), std::pair(0.8, 0.25), std::pair(0.8, 0.75), std::pair(0.2, 0.75)}) {
            ring.push_back(builder.place(low + Eigen::Vector3d(fx * sx, fy * sy, 0.0), PlaceKind::kRoom));
          }
          for (std::size_t k = 0; k < 4; ++k) {
            builder.way(ring[k], ring[(k + 1) % 4], {builder.at(ring[k]), builder.at(ring[(k + 1) % 4])}, 0.4,
                        false);
          }
          open_door(low.x() + 0.2 * sx, false, 2.0 * u.door_width_m, ring[0], builder.at(ring[0]));
          open_door(low.x() + 0.8 * sx, true, 2.0 * u.door_width_m, ring[2], builder.at(ring[2]));
          furnish_hall(low, sx, sy, height);
          continue;
        }
        const double split_x = rng.uniform(0.4, 0.6) * sx;
        const bool two_rows = rng.uniform() < 0.6;
        const double split_y = two_rows ? rng.uniform(0.42, 0.58) * sy : sy;
        const double half_wall = 0.5 * u.wall_m;
        for (int row = 0; row < (two_rows ? 2 : 1); ++row) {
          const double y0 = row == 0 ? 0.0 : split_y + half_wall;
          const double y1 = row == 0 && two_rows ? split_y - half_wall : sy;
          const bool north = two_rows ? row == 1 : rng.uniform() < 0.5;
          std::array<std::size_t, 2> pair{};
          std::array<Eigen::Vector3d, 2> centre;
          for (std::size_t k = 0; k < 2; ++k) {
            const double x0 = k == 0 ? 0.0 : split_x + half_wall, x1 = k == 0 ? split_x - half_wall : sx;
            const Eigen::Vector3d room_low = low + Eigen::Vector3d(x0, y0, 0.0);
            builder.add(box_shape(room_low, x1 - x0, y1 - y0, u.room_height_m));
            centre[k] = room_low + Eigen::Vector3d(0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.0);
            pair[k] = builder.place(centre[k], PlaceKind::kRoom);
            open_door(room_low.x() + rng.uniform(0.3, 0.7) * (x1 - x0), north, u.door_width_m, pair[k],
                      centre[k]);
            furnish_room(room_low, x1 - x0, y1 - y0);
          }
          if (rng.uniform() < u.inner_door_share) {
            const Eigen::Vector3d a(low.x() + split_x - 0.8, centre[0].y(), z),
                b(low.x() + split_x + 0.8, centre[0].y(), z);
            doorway(a, b, u.door_width_m);
            builder.way(pair[0], pair[1], {centre[0], a, b, centre[1]}, 0.15, false);
          }
        }
      }
    }
    for (int i = 0; i <= columns; ++i) {
      for (int j = 0; j < rows; ++j) {
        flat_passage(junctions.at({i, j}), junctions.at({i, j + 1}), width_x[static_cast<std::size_t>(i)]);
      }
    }
    for (int j = 0; j <= rows; ++j) {
      for (int i = 0; i < columns; ++i) {
        const std::pair<int, int> cell(i, j);
        auto& list = doors[cell];
        std::sort(list.begin(), list.end());
        std::size_t from = junctions.at(cell);
        for (const auto& [x, place] : list) {
          flat_passage(from, place, width_y[static_cast<std::size_t>(j)]);
          from = place;
        }
        flat_passage(from, junctions.at({i + 1, j}), width_y[static_cast<std::size_t>(j)]);
      }
      // Cable trays and pipes under the corridor's ceiling.
      const double y = ys[static_cast<std::size_t>(j)] + 0.25 * width_y[static_cast<std::size_t>(j)];
      builder.pipe(Eigen::Vector3d(xs.front(), y, z + 2.5), Eigen::Vector3d(xs.back(), y, z + 2.5), 0.1);
    }
  }
  if (floors < 2) return ground_floor;

  // A flight of stairs outside the west wall and one outside the east wall.
  for (const bool east : {false, true}) {
    const int i = east ? columns : 0, j = east ? rows - 1 : 0;
    const double x = xs[static_cast<std::size_t>(i)] + (east ? 2.6 : -2.6);
    const std::size_t low = ground_floor.at({i, j}), high = upper_floor.at({i, j + 1});
    const Eigen::Vector3d a = builder.at(low), b = builder.at(high);
    const Eigen::Vector3d a1(x, a.y(), a.z()), a2(x, a.y() + 1.2, a.z()), b2(x, b.y() - 1.2, b.z()),
        b1(x, b.y(), b.z());
    Style s = corridor(1.7);
    s.height = 2.6;
    builder.cut({a, a1, a2, b2, b1, b}, s);
    builder.way(low, high, {a, a1, a2, b2, b1, b}, 0.15, true);
    const int steps = static_cast<int>(std::lround(u.storey_m / u.step_rise_m));
    const Eigen::Vector3d run = (b2 - a2) / steps;
    for (int k = 0; k < steps; ++k) {
      const Eigen::Vector3d tread = a2 + (k + 0.5) * run;
      builder.step(tread, Eigen::Vector3d(1.0, 0.0, 0.0), Eigen::Vector3d(0.0, 0.5 * run.y(), 0.0),
                   0.5 * run.z());
    }
  }
  return ground_floor;
}

void plan_urban(Builder& builder, double target) {
  const std::size_t gate = builder.place(0.0, 0.0);
  // A block with its corridors and rooms holds about 75 m of ways; see passage_length_m() of what comes out.
  const int floors = target > 150.0 ? 2 : 1;
  const double blocks = std::max(1.0, target / (75.0 * floors));
  const int rows = std::max(1, static_cast<int>(std::lround(std::sqrt(blocks * 0.8))));
  const int columns = std::max(1, static_cast<int>(std::lround(blocks / rows)));
  const auto corners = plan_building(builder, {8.0, 0.0}, columns, rows, floors);
  Style s;
  s.half_width = 1.5;
  s.height = 2.8;
  s.roughness = &parameters::kConcrete;
  builder.passage(gate, corners.at({0, 0}), s);
}

void plan_finals(Builder& builder, double target) {
  Rng& rng = builder.rng();
  builder.set_undulation(parameters::kCaveShape.undulation_m, -8.0);
  const std::size_t gate = builder.place(0.0, 0.0);
  const std::size_t hub = builder.place(10.0, 0.0);
  builder.passage(gate, hub, entry_style(builder));
  const double share = (target - 60.0) / 3.0;

  // Tunnel section to the north.
  const double spacing = parameters::kTunnel.entry_spacing_m;
  const double length = std::max(25.0, (share - 2.0 * spacing) / (2.0 + spacing / 40.0));
  std::vector<double> cuts{0.0};
  for (const double s : cross_cuts(rng, length)) cuts.push_back(s);
  std::vector<std::vector<std::size_t>> entries;
  parallel_entries(builder, {10.0, 12.0}, {0.0, 1.0}, {-spacing, 0.0}, {}, cuts, 2, &entries);
  builder.passage(hub, entries[0][0], entry_style(builder));
  furnish_entries(builder);

  // Cave to the east: only rows from its entrance northwards, away from the building.
  const auto cave = plan_cave(builder, {30.0, 2.0}, std::max(40.0, share), 0, 1000);
  Style s = entry_style(builder);
  builder.passage(hub, cave.at({0, 0}), s);
  // The far end of the tunnel section leads into the cave.
  const Eigen::Vector3d end = builder.at(entries.back()[0]);
  std::size_t nearest = cave.at({0, 0});
  for (const auto& [index, place] : cave) {
    if ((builder.at(place) - end).norm() < (builder.at(nearest) - end).norm()) nearest = place;
  }
  builder.passage(entries.back()[0], nearest, s);

  // Urban section to the south, one floor; its north side is a corridor.
  const int columns = std::max(1, static_cast<int>(std::lround(share / 75.0)));
  const double depth = parameters::kUrban.block_y_m.high + 11.0;
  const auto corners = plan_building(builder, {10.0, -depth}, columns, 1, 1);
  builder.passage(hub, corners.at({0, 1}), s);
  builder.passage(corners.at({columns, 1}), cave.at({0, 0}), s);
}

}  // namespace

double World::passage_length_m() const {
  double sum = 0.0;
  for (const auto& passage : routes.passages) sum += passage.length_m;
  return sum;
}

World make_world(WorldKind kind, double length_m, std::uint64_t seed, int threads, const StopToken& stop) {
  detail::check_bounds("length_m", length_m, between(60.0, 60000.0));
  Builder builder(combine_seeds(seed, static_cast<std::uint64_t>(kind)));
  const double target = parameters::kPassagesPerDrivenLength * length_m;
  double cell = parameters::kTunnelCell;
  switch (kind) {
    case WorldKind::kTunnel:
      plan_tunnel(builder, target);
      break;
    case WorldKind::kUrban:
      cell = parameters::kUrbanCell;
      plan_urban(builder, target);
      break;
    case WorldKind::kFinals:
      cell = parameters::kFinalsCell;
      plan_finals(builder, target);
      break;
    case WorldKind::kMine:
      cell = parameters::kMineCell;
      plan_mine(builder, target);
      break;
  }
  return builder.build(kind, cell, threads, stop);
}

}  // namespace loopwise
