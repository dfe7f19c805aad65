// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/world.hpp>

#include <algorithm>
#include <cmath>

#include <loopwise/core/options.hpp>
#include <loopwise/core/random.hpp>

#include "parameters.hpp"
#include "world_plans.hpp"

namespace loopwise {
namespace simulation_detail {
namespace {

void plan_urban(Builder& builder, double target) {
  const std::size_t gate = builder.place(0.0, 0.0);
  // A block with its corridors and rooms has about 75 m of passages. passage_length_m() gives the actual
  // length.
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

  // Cave to the east. It grows only northwards from its entrance, away from the building.
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
}  // namespace simulation_detail

double World::passage_length_m() const {
  double sum = 0.0;
  for (const auto& passage : routes.passages) sum += passage.length_m;
  return sum;
}

World make_world(WorldKind kind, double length_m, std::uint64_t seed, int threads, const StopToken& stop) {
  detail::check_bounds("length_m", length_m, between(60.0, 60000.0));
  namespace sim = simulation_detail;
  namespace parameters = simulation_parameters;
  sim::Builder builder(combine_seeds(seed, static_cast<std::uint64_t>(kind)));
  const double target = parameters::kPassagesPerDrivenLength * length_m;
  double cell = parameters::kTunnelCell;
  switch (kind) {
    case WorldKind::kTunnel:
      sim::plan_tunnel(builder, target);
      break;
    case WorldKind::kUrban:
      cell = parameters::kUrbanCell;
      sim::plan_urban(builder, target);
      break;
    case WorldKind::kFinals:
      cell = parameters::kFinalsCell;
      sim::plan_finals(builder, target);
      break;
    case WorldKind::kMine:
      cell = parameters::kMineCell;
      sim::plan_mine(builder, target);
      break;
  }
  return builder.build(kind, cell, threads, stop);
}

}  // namespace loopwise
