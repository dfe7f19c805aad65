// SPDX-License-Identifier: BSD-3-Clause
#include "world_builder.hpp"

namespace loopwise::simulation_detail {
namespace {

void add_quad(TriangleMesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
  mesh.triangles.push_back({a, b, c});
  mesh.triangles.push_back({a, c, d});
}

void add_box(TriangleMesh& mesh, const Eigen::Vector3d& floor, const Eigen::Vector3d& u,
             const Eigen::Vector3d& v, double height) {
  const auto base = static_cast<std::uint32_t>(mesh.vertices.size());
  for (int k = 0; k < 8; ++k) {
    Eigen::Vector3d p =
        floor + ((k & 1) != 0 ? u : Eigen::Vector3d(-u)) + ((k & 2) != 0 ? v : Eigen::Vector3d(-v));
    p.z() += (k & 4) != 0 ? height : -0.3;  // the base extends into the rough floor
    mesh.vertices.push_back(p.cast<float>());
  }
  add_quad(mesh, base + 4, base + 5, base + 7, base + 6);
  add_quad(mesh, base, base + 1, base + 5, base + 4);
  add_quad(mesh, base + 2, base + 3, base + 7, base + 6);
  add_quad(mesh, base, base + 2, base + 6, base + 4);
  add_quad(mesh, base + 1, base + 3, base + 7, base + 5);
}

void add_prism(TriangleMesh& mesh, const Eigen::Vector3d& a, const Eigen::Vector3d& b, double radius,
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

}  // namespace

void Builder::passage(std::size_t from, std::size_t to, const Style& style) {
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

void Builder::cut(const std::vector<Eigen::Vector3d>& path, const Style& style) {
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

void Builder::box(const Eigen::Vector3d& floor, double length, double width, double height, double yaw,
                  double reach) {
  things_.push_back([=](TriangleMesh& mesh) {
    const Eigen::Vector3d u = 0.5 * length * Eigen::Vector3d(std::cos(yaw), std::sin(yaw), 0.0);
    const Eigen::Vector3d v = 0.5 * width * Eigen::Vector3d(-std::sin(yaw), std::cos(yaw), 0.0);
    add_box(mesh, floor, u, v, height);
  });
  foot_.push_back({floor, reach});
}

void Builder::post(const Eigen::Vector3d& floor, double radius, double height) {
  things_.push_back([=](TriangleMesh& mesh) {
    add_prism(mesh, floor, floor + Eigen::Vector3d(0.0, 0.0, height), radius, 10);
  });
  foot_.push_back({floor, radius});
}

void Builder::pipe(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double radius) {
  things_.push_back([=](TriangleMesh& mesh) { add_prism(mesh, a, b, radius, 8); });
  foot_.push_back({a, -1.0});
}

void Builder::step(const Eigen::Vector3d& floor, const Eigen::Vector3d& u, const Eigen::Vector3d& v,
                   double height) {
  things_.push_back([=](TriangleMesh& mesh) { add_box(mesh, floor, u, v, height); });
  foot_.push_back({floor, -1.0});
}

World Builder::build(WorldKind kind, double cell, int threads, const StopToken& stop) {
  World world;
  world.kind = kind;
  mark_dead_ends();
  world.mesh = extract_surface(
      shapes_, [this](double x, double y) { return ground(x, y); }, cell, combine_seeds(seed_, 3), threads,
      stop);
  for (std::size_t i = 0; i < things_.size(); ++i) {
    if (foot_[i].radius < 0.0 || out_of_the_way(foot_[i])) things_[i](world.mesh);
  }
  world.routes = routes_;
  return world;
}

bool Builder::out_of_the_way(const Foot& foot) const {
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

void Builder::mark_dead_ends() {
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

}  // namespace loopwise::simulation_detail
