// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <queue>
#include <vector>

#include <loopwise/simulation/ray_caster.hpp>
#include <loopwise/simulation/world.hpp>

#include "parameters.hpp"
#include "surface.hpp"
#include "testing.hpp"

namespace loopwise::world_test {

using namespace simulation_detail;

TEST_CASE("ray caster: a square and a miss", "[simulation]") {
  TriangleMesh mesh;
  mesh.vertices = {{2.0F, -1.0F, -1.0F}, {2.0F, 1.0F, -1.0F}, {2.0F, 1.0F, 1.0F}, {2.0F, -1.0F, 1.0F}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  const RayCaster caster(mesh);
  const auto hit = caster.cast({0.0F, 0.0F, 0.0F}, {1.0F, 0.0F, 0.0F}, 10.0F);
  REQUIRE(hit);
  REQUIRE(hit->distance_m == Approx(2.0));
  REQUIRE(hit->normal.x() == Approx(-1.0));
  REQUIRE_FALSE(caster.cast({0.0F, 0.0F, 0.0F}, {1.0F, 0.0F, 0.0F}, 1.9F));
  REQUIRE_FALSE(caster.cast({0.0F, 0.0F, 0.0F}, {-1.0F, 0.0F, 0.0F}, 10.0F));
  REQUIRE_FALSE(RayCaster(TriangleMesh{}).cast({0.0F, 0.0F, 0.0F}, {1.0F, 0.0F, 0.0F}, 10.0F));
}

TEST_CASE("gradient noise: mean 0, root mean square 1, continuous", "[simulation][property]") {
  Rng rng(1);
  double sum = 0.0, squares = 0.0;
  const int count = 200000;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d p(rng.uniform(-100.0, 100.0), rng.uniform(-100.0, 100.0),
                            rng.uniform(-100.0, 100.0));
    const double x = gradient_noise(p, 9);
    sum += x;
    squares += x * x;
    REQUIRE(std::abs(gradient_noise(p + Eigen::Vector3d::Constant(1e-7), 9) - x) < 1e-5);
  }
  REQUIRE(std::abs(sum / count) < 0.01);
  REQUIRE(std::sqrt(squares / count) == Approx(1.0).margin(0.02));
}

TEST_CASE("surface: a smooth box comes out flat, square and closed", "[simulation]") {
  const simulation_parameters::Roughness smooth{{0.0, 0.0, 0.0}, {1.0, 1.0, 1.0}, 0.0};
  Shape room;
  room.kind = Shape::Kind::kBox;
  room.a = {0.3, 0.1, 0.0};
  room.half_width = 3.03;
  room.half_length = 2.07;
  room.height = 2.51;
  room.roughness = &smooth;
  const RayCaster caster(extract_surface({room}, [](double, double) { return 0.0; }, 0.25, 1, 1, {}));
  Rng rng(2);
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d origin(0.3 + rng.uniform(-2.5, 2.5), 0.1 + rng.uniform(-1.5, 1.5),
                                 rng.uniform(0.3, 2.2));
    Eigen::Vector3d d = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
    double expected = 1e9;
    const Eigen::Vector3d low(0.3 - 3.03, 0.1 - 2.07, 0.0), high(0.3 + 3.03, 0.1 + 2.07, 2.51);
    for (int k = 0; k < 3; ++k)
      expected = std::min(expected, ((d[k] > 0 ? high[k] : low[k]) - origin[k]) / d[k]);
    const auto hit = caster.cast(origin.cast<float>(), d.cast<float>(), 100.0F);
    REQUIRE(hit);
    // Edges lie in cells of 0.25 m and are drawn in a little: 0.05 m was the worst of the points.
    const Eigen::Vector3d p = origin + static_cast<double>(hit->distance_m) * d;
    REQUIRE((p - low).minCoeff() > -0.1);
    REQUIRE((high - p).minCoeff() > -0.1);
    REQUIRE(std::min((p - low).minCoeff(), (high - p).minCoeff()) < 0.1);
  }
}

TEST_CASE("worlds: connected, closed and clear where robots drive", "[simulation][property]") {
  for (const auto& [kind, name] : enum_names(WorldKind{})) {
    const std::uint64_t seed = GENERATE(1U, 2U, 3U);
    CAPTURE(name, seed);
    const World world = make_world(kind, 400.0, seed);
    const RayCaster caster(world.mesh);

    std::vector<char> reached(world.routes.places.size(), 0);
    std::queue<std::size_t> open;
    open.push(0);
    reached[0] = 1;
    while (!open.empty()) {
      const std::size_t here = open.front();
      open.pop();
      for (const auto& p : world.routes.passages) {
        for (const auto& [from, to] : {std::pair(p.from, p.to), std::pair(p.to, p.from)}) {
          if (from == here && reached[to] == 0) {
            reached[to] = 1;
            open.push(to);
          }
        }
      }
    }
    REQUIRE(std::count(reached.begin(), reached.end(), 0) == 0);
    // Passages for half of the driven path: building blocks are coarse in small worlds.
    REQUIRE(world.passage_length_m() > 0.6 * 200.0);
    REQUIRE(world.passage_length_m() < 1.8 * 200.0);

    std::size_t leaks = 0, rays = 0;
    Rng rng(seed);
    for (const auto& passage : world.routes.passages) {
      for (std::size_t i = 1; i < passage.path.size(); ++i) {
        const Eigen::Vector3d a = passage.path[i - 1], b = passage.path[i];
        const Eigen::Vector3f from = (a + Eigen::Vector3d(0.0, 0.0, 0.7)).cast<float>();
        const auto way = (b - a).cast<float>();
        REQUIRE_FALSE(caster.cast(from, way.normalized(), way.norm()));
        for (int k = 0; k < 20; ++k) {
          const Eigen::Vector3d d = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
          ++rays;
          if (!caster.cast(from, d.cast<float>(), 1000.0F)) ++leaks;
        }
      }
    }
    CAPTURE(rays, leaks);
    REQUIRE(leaks == 0);
  }
}

TEST_CASE("worlds: lengths out of range", "[simulation][error]") {
  REQUIRE_THROWS_WITH(make_world(WorldKind::kTunnel, 10.0, 1), "length_m = 10, must be in [60, 60000]");
  REQUIRE_THROWS_AS(make_world(WorldKind::kMine, std::nan(""), 1), OptionError);
}

}  // namespace loopwise::world_test
