// SPDX-License-Identifier: BSD-3-Clause
#include "radio.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include <loopwise/core/random.hpp>

#include "parameters.hpp"
#include "surface.hpp"

namespace loopwise::simulation_detail {
namespace {

namespace parameters = simulation_parameters;

const parameters::RadioWorld& radio_world(WorldKind kind) {
  switch (kind) {
    case WorldKind::kTunnel:
      return parameters::kTunnelRadio;
    case WorldKind::kUrban:
      return parameters::kUrbanRadio;
    case WorldKind::kFinals:
      return parameters::kFinalsRadio;
    case WorldKind::kMine:
      break;
  }
  return parameters::kMineRadio;
}

Waypoint gate() {
  return {};
}  // passage 0 touches place 0 in every world, see gate_waypoint()

Waypoint gate_waypoint(const RouteGraph& routes) {
  Waypoint w = gate();
  for (std::size_t p = 0; p < routes.passages.size(); ++p) {
    if (routes.passages[p].from == 0 || routes.passages[p].to == 0) {
      w.passage = p;
      w.along_m = routes.passages[p].from == 0 ? 0.0 : routes.passages[p].length_m;
      break;
    }
  }
  return w;
}

/// Number of walls between two points. The ray enters and leaves each wall.
int count_walls(const RayCaster& caster, const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  const Eigen::Vector3f direction = (to - from).normalized().cast<float>();
  Eigen::Vector3f origin = from.cast<float>();
  auto left = static_cast<float>((to - from).norm());
  int surfaces = 0;
  while (surfaces < 2 * parameters::kMaxWalls) {
    const auto hit = caster.cast(origin, direction, left);
    if (!hit) break;
    ++surfaces;
    // Continues behind the surface. A wall that is thinner than this step counts as one surface.
    const float on = hit->distance_m + 0.05F;
    if (on >= left) break;
    origin += on * direction;
    left -= on;
  }
  return std::min(parameters::kMaxWalls, (surfaces + 1) / 2);
}

}  // namespace

std::vector<Drop> drop_beacons(const RouteGraph& routes, const Distances& ways, std::vector<Drive>& team,
                               std::uint64_t seed) {
  Rng rng(seed);
  std::vector<Drop> drops;
  std::vector<Waypoint> relays{gate_waypoint(routes)};
  struct Carrier {
    std::size_t next = 0;
    int left = parameters::kBeaconsPerRobot;
    double limit = 0.0;
  };
  std::vector<Carrier> carriers(team.size());
  for (Carrier& c : carriers)
    c.limit = rng.uniform(parameters::kDropDistance.low, parameters::kDropDistance.high);
  while (true) {
    std::size_t robot = team.size();
    for (std::size_t r = 0; r < team.size(); ++r) {
      if (carriers[r].next >= team[r].waypoints.size()) continue;
      if (robot == team.size() || team[r].time_s[carriers[r].next] < team[robot].time_s[carriers[robot].next])
        robot = r;
    }
    if (robot == team.size()) break;
    Carrier& carrier = carriers[robot];
    const std::size_t node = carrier.next++;
    if (carrier.left == 0) continue;
    const Waypoint& here = team[robot].waypoints[node];
    double nearest = std::numeric_limits<double>::infinity();
    for (const Waypoint& relay : relays) nearest = std::min(nearest, ways.between(routes, here, relay));
    if (nearest < carrier.limit) continue;
    --carrier.left;
    carrier.limit = rng.uniform(parameters::kDropDistance.low, parameters::kDropDistance.high);
    relays.push_back(here);
    drops.push_back({robot, node});
    for (std::size_t k = node + 1; k < team[robot].time_s.size(); ++k) {
      team[robot].time_s[k] += parameters::kDropSeconds;
    }
  }
  return drops;
}

std::vector<CommunicationGap> communication_gaps(const RouteGraph& routes, const Distances& ways,
                                                 const std::vector<Drive>& team,
                                                 const std::vector<Drop>& drops, std::uint64_t seed) {
  std::vector<CommunicationGap> gaps;
  const Waypoint gate_relay = gate_waypoint(routes);
  for (std::size_t r = 0; r < team.size(); ++r) {
    Rng rng(combine_seeds(seed, r));
    const Drive& drive = team[r];
    if (drive.waypoints.empty()) continue;
    std::vector<std::pair<double, double>> windows;
    double out_since = -1.0;
    for (std::size_t k = 0; k < drive.waypoints.size(); ++k) {
      const Waypoint& here = drive.waypoints[k];
      double nearest = ways.between(routes, here, gate_relay);
      for (const Drop& drop : drops) {
        if (team[drop.robot].time_s[drop.node] > drive.time_s[k]) continue;
        nearest = std::min(nearest, ways.between(routes, here, team[drop.robot].waypoints[drop.node]));
      }
      const bool out = nearest > parameters::kNetworkReach;
      if (out && out_since < 0.0) out_since = drive.time_s[k];
      if (!out && out_since >= 0.0) {
        windows.emplace_back(out_since, drive.time_s[k]);
        out_since = -1.0;
      }
    }
    // A robot that is out of reach at the end of its drive is reached a little later.
    const double end = drive.time_s.back() + 30.0;
    if (out_since >= 0.0) windows.emplace_back(out_since, end);
    double t = drive.time_s.front();
    while (true) {
      t += -std::log(1.0 - rng.uniform()) / parameters::kOutagesPerSecond;
      const double length = rng.uniform(parameters::kOutageSeconds.low, parameters::kOutageSeconds.high);
      if (t > drive.time_s.back()) break;
      windows.emplace_back(t, std::min(t + length, end));
      t += length;
    }
    std::sort(windows.begin(), windows.end());
    for (const auto& [from, to] : windows) {
      const double begin = std::floor(from), finish = std::ceil(to);
      if (finish - begin < 5.0) continue;
      if (!gaps.empty() && gaps.back().robot == r && begin <= gaps.back().end_s) {
        gaps.back().end_s = std::max(gaps.back().end_s, finish);
      } else {
        gaps.push_back({r, begin, finish});
      }
    }
  }
  return gaps;
}

Eigen::Vector3d beacon_position(const std::vector<Drive>& team, const Drop& drop) {
  const Drive& drive = team[drop.robot];
  const Eigen::Isometry3d& T = drive.waypoints[drop.node].T_world_body;
  // Behind the robot, low above the floor.
  const Eigen::Vector3d back = T.linear().col(0);
  Eigen::Vector3d position = T.translation() - 0.6 * back;
  position.z() = T.translation().z() - 0.75 + parameters::kBeaconHeight;
  return position;
}

std::vector<Reception> receptions_of(const RayCaster& caster, WorldKind kind, const std::vector<Drive>& team,
                                     const std::vector<Drop>& drops, std::uint64_t seed, ThreadPool& pool) {
  const parameters::RadioWorld& radio = radio_world(kind);
  std::vector<std::pair<std::size_t, std::size_t>> nodes;
  for (std::size_t r = 0; r < team.size(); ++r) {
    for (std::size_t k = 0; k < team[r].waypoints.size(); ++k) nodes.emplace_back(r, k);
  }
  std::vector<std::vector<Reception>> receptions(nodes.size());
  pool.for_each(nodes.size(), [&](std::size_t n) {
    const auto [robot, node] = nodes[n];
    const Eigen::Vector3d here = team[robot].waypoints[node].T_world_body.translation();
    const double now = team[robot].time_s[node];
    for (std::size_t d = 0; d < drops.size(); ++d) {
      const Drop& drop = drops[d];
      if (now <= team[drop.robot].time_s[drop.node]) continue;
      const Eigen::Vector3d there = beacon_position(team, drop);
      const double distance = (there - here).norm();
      if (distance > parameters::kRadioRange) continue;
      Rng rng(combine_seeds(combine_seeds(seed, d), (static_cast<std::uint64_t>(robot) << 32) | node));
      Reception h{robot, node, d, {}, distance, count_walls(caster, there, here)};
      // Shadowing depends on the place alone, so a robot that returns measures the same shadowing.
      const double shadowing =
          parameters::kShadowingSigmaDb *
          gradient_noise(here / parameters::kShadowingLength, combine_seeds(seed, 7 + d));
      const double loss = parameters::kRadioLossAt1m +
                          10.0 * radio.exponent * std::log10(std::max(distance, 1.0)) +
                          radio.wall_db * h.walls + shadowing;
      bool any = false;
      for (int k = 0; k < parameters::kReceivers; ++k) {
        const double fading = parameters::kFadingSigmaDb * rng.normal(), luck = rng.uniform();
        const double power =
            std::round((parameters::kTransmitDbm - loss + fading) * 2.0) / 2.0;  // in half dB
        const bool missed = power < parameters::kSensitivityDbm || luck < parameters::kMissingShare;
        h.receive_dbm.push_back(missed ? std::numeric_limits<double>::quiet_NaN() : power);
        any = any || !missed;
      }
      if (any) receptions[n].push_back(std::move(h));
    }
  });
  std::vector<Reception> all;
  for (auto& part : receptions) {
    for (Reception& h : part) all.push_back(std::move(h));
  }
  return all;
}

}  // namespace loopwise::simulation_detail
