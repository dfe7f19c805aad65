// SPDX-License-Identifier: BSD-3-Clause
// Lattices: a limestone mine of rooms and pillars, and a cave.
#include "world_plans.hpp"

namespace loopwise::simulation_detail {
namespace {

struct Lattice {
  Eigen::Vector2d origin;
  double pitch_x, pitch_y;
  double jitter;
  double closed_share;
  int j_low, j_high;  ///< Rows that exist.
};

/// Grows passages over a jittered lattice outwards from (0, 0), until their total length is `target` metres.
template <class MakeStyle>
PlaceGrid grow_lattice(Builder& builder, const Lattice& lattice, double target, MakeStyle&& make_style) {
  Rng& rng = builder.rng();
  const double pitch = std::min(lattice.pitch_x, lattice.pitch_y);
  const int reach = std::max(2, static_cast<int>(std::ceil(1.6 * std::sqrt(target / (2.0 * pitch))) + 2.0));
  std::vector<std::pair<double, std::pair<int, int>>> order;
  for (int i = 0; i <= 2 * reach; ++i) {
    for (int j = std::max(-reach, lattice.j_low); j <= std::min(reach, lattice.j_high); ++j) {
      // The factor lets columns open about as easily as rows. Chance makes the outline irregular.
      order.push_back({std::hypot(0.8 * i, j) * (1.0 + 0.35 * rng.uniform()), {i, j}});
    }
  }
  std::sort(order.begin(), order.end());
  order.erase(
      std::remove_if(order.begin(), order.end(), [](const auto& o) { return o.second == std::pair(0, 0); }),
      order.end());
  PlaceGrid places;
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
    // Opens the first place in the order that is next to an open place.
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

}  // namespace

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
      // Rubble from the ribs lies at their foot, and sometimes a machine stands aside.
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

PlaceGrid plan_cave(Builder& builder, const Eigen::Vector2d& origin, double target, int j_low, int j_high) {
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

}  // namespace loopwise::simulation_detail
