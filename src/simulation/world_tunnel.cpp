// SPDX-License-Identifier: BSD-3-Clause
// A coal mine: parallel entries with cross-cuts, and panels of them.
#include "world_plans.hpp"

namespace loopwise::simulation_detail {
namespace {

/// Extends the entries by some metres beyond the last cross-cut, to the faces where the seam is mined.
void add_faces(Builder& builder, const std::vector<std::size_t>& ends, const Eigen::Vector2d& along) {
  for (const std::size_t end : ends) {
    const Eigen::Vector2d p =
        builder.at(end).head<2>() + draw(builder.rng(), parameters::kTunnel.face_m) * along;
    builder.passage(end, builder.place(p.x(), p.y()), entry_style(builder));
  }
}

}  // namespace

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

std::vector<std::size_t> parallel_entries(Builder& builder, const Eigen::Vector2d& start,
                                          const Eigen::Vector2d& along, const Eigen::Vector2d& across,
                                          std::vector<std::size_t> first, const std::vector<double>& cuts,
                                          std::size_t count, std::vector<std::vector<std::size_t>>* places) {
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
  // Places on the mains where a panel, which is a pair of entries, starts on either side.
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
    std::vector<std::size_t> neighbour;  // far ends of the previous panel
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

}  // namespace loopwise::simulation_detail
