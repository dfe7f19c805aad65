// SPDX-License-Identifier: BSD-3-Clause
#include "planner.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

#include "surface.hpp"

namespace loopwise::simulation_detail {
namespace {

constexpr double kStep = 0.1;           ///< Of the dense way, m.
constexpr double kSmooth = 1.2;         ///< Half the window that rounds the corners, m.
constexpr double kWanderLength = 25.0;  ///< Path length over which a robot changes sides, m.
constexpr double kWanderShare = 0.45;   ///< Of the free half width, 1 sigma.

double rounded(double x, double quantum) {
  return std::round(x / quantum) * quantum;
}

struct Dense {
  Eigen::Vector3d position;
  Eigen::Vector2d left;
  double half_width;
  std::size_t passage;
  double along;
};

/// Path along the centre lines of the legs with offsets to the side, which is smoothed afterwards, for
/// `count` key frames and some more.
std::vector<Dense> dense_path(const RouteGraph& routes, const std::vector<Leg>& legs, double spacing_m,
                              std::size_t count, double phase, std::uint64_t seed) {
  std::vector<Dense> dense;
  double s = 0.0;
  for (const Leg& leg : legs) {
    const auto& p = routes.passages[leg.passage];
    std::vector<Eigen::Vector3d> path = p.path;
    if (!leg.forward) std::reverse(path.begin(), path.end());
    double along = 0.0;
    for (std::size_t i = 1; i < path.size(); ++i) {
      const Eigen::Vector3d d = path[i] - path[i - 1];
      const double length = d.norm();
      const int steps = std::max(1, static_cast<int>(std::lround(length / kStep)));
      const Eigen::Vector2d flat = d.head<2>().normalized();
      for (int k = 0; k < steps; ++k) {
        const double t = static_cast<double>(k) / steps;
        Dense point;
        point.position = path[i - 1] + t * d;
        point.left = {-flat.y(), flat.x()};
        // The offset shrinks towards both ends of a passage, so that consecutive passages join.
        point.half_width = std::min(
            p.half_width_m, 0.15 + 0.5 * std::min(along + t * length, p.length_m - along - t * length));
        point.passage = leg.passage;
        point.along = leg.forward ? along + t * length : p.length_m - along - t * length;
        const double wander =
            kWanderShare * gradient_noise(Eigen::Vector3d(phase + s / kWanderLength, 0.5, 0.5), seed);
        point.position.head<2>() +=
            std::clamp(wander, -1.0, 1.0) * std::max(0.0, point.half_width) * point.left;
        dense.push_back(point);
        s += length / steps;
      }
      along += length;
    }
    if (s > 1.3 * spacing_m * static_cast<double>(count) + 20.0) break;
  }
  return dense;
}

/// Means over a window of kSmooth, which shrinks towards both ends.
std::vector<Eigen::Vector3d> smoothed(const std::vector<Dense>& dense) {
  const auto window = static_cast<std::size_t>(kSmooth / kStep);
  std::vector<Eigen::Vector3d> smooth(dense.size());
  std::vector<Eigen::Vector3d> sums(dense.size() + 1, Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < dense.size(); ++i) sums[i + 1] = sums[i] + dense[i].position;
  for (std::size_t i = 0; i < dense.size(); ++i) {
    const std::size_t reach = std::min({window, i, dense.size() - 1 - i});
    smooth[i] = (sums[i + reach + 1] - sums[i - reach]) / static_cast<double>(2 * reach + 1);
  }
  return smooth;
}

}  // namespace

Distances::Distances(const RouteGraph& routes)
    : count_(routes.places.size()),
      distance_(count_ * count_, std::numeric_limits<float>::infinity()),
      first_(count_ * count_, 0) {
  std::vector<std::vector<std::pair<std::size_t, std::size_t>>> at(count_);  // (neighbour, passage)
  for (std::size_t p = 0; p < routes.passages.size(); ++p) {
    at[routes.passages[p].from].emplace_back(routes.passages[p].to, p);
    at[routes.passages[p].to].emplace_back(routes.passages[p].from, p);
  }
  for (std::size_t start = 0; start < count_; ++start) {
    float* distance = &distance_[start * count_];
    std::uint32_t* first = &first_[start * count_];
    std::priority_queue<std::pair<float, std::size_t>, std::vector<std::pair<float, std::size_t>>,
                        std::greater<>>
        open;
    distance[start] = 0.0F;
    open.emplace(0.0F, start);
    while (!open.empty()) {
      const auto [d, here] = open.top();
      open.pop();
      if (d > distance[here]) continue;
      for (const auto& [next, passage] : at[here]) {
        const float there = d + static_cast<float>(routes.passages[passage].length_m);
        if (there < distance[next]) {
          distance[next] = there;
          first[next] = here == start ? static_cast<std::uint32_t>(passage) : first[here];
          open.emplace(there, next);
        }
      }
    }
  }
}

double Distances::between(const RouteGraph& routes, const Waypoint& a, const Waypoint& b) const {
  const auto& pa = routes.passages[a.passage];
  const auto& pb = routes.passages[b.passage];
  double best =
      a.passage == b.passage ? std::abs(a.along_m - b.along_m) : std::numeric_limits<double>::infinity();
  for (const bool a_back : {true, false}) {
    for (const bool b_back : {true, false}) {
      best = std::min(best, (a_back ? a.along_m : pa.length_m - a.along_m) +
                                (b_back ? b.along_m : pb.length_m - b.along_m) +
                                between(a_back ? pa.from : pa.to, b_back ? pb.from : pb.to));
    }
  }
  return best;
}

std::vector<std::vector<Leg>> plan_routes(const RouteGraph& routes, int robots, double length_m,
                                          std::uint64_t seed) {
  struct State {
    std::vector<Leg> legs;
    std::size_t place = 0;
    double driven = 0.0;
    bool comes_back = false;
    bool done = false;
  };
  Rng rng(seed);
  const Distances ways(routes);
  std::vector<State> team(static_cast<std::size_t>(robots));
  // Most robots return to the gate before their time is up.
  for (State& robot : team) robot.comes_back = rng.uniform() < 0.7;
  std::vector<int> visits(routes.passages.size(), 0);

  const auto go = [&](State& robot, std::size_t passage) {
    const auto& p = routes.passages[passage];
    const bool forward = p.from == robot.place;
    robot.legs.push_back({passage, forward});
    robot.place = forward ? p.to : p.from;
    robot.driven += p.length_m;
    ++visits[passage];
  };
  const auto go_to = [&](State& robot, std::size_t place) {
    while (robot.place != place) go(robot, ways.first_passage(robot.place, place));
  };

  while (true) {
    // The robot with the shortest driven distance decides next, as if all robots had the same speed.
    State* robot = nullptr;
    for (State& r : team) {
      if (!r.done && (!robot || r.driven < robot->driven)) robot = &r;
    }
    if (!robot) break;
    if (robot->driven >= 1.2 * length_m + 20.0) {
      robot->done = true;
      continue;
    }
    const double home = ways.between(robot->place, 0);
    if (robot->comes_back && robot->place != 0 && length_m - robot->driven < 1.15 * home + 5.0) {
      go_to(*robot, 0);
      robot->comes_back = false;  // the remaining distance is driven near the gate
      continue;
    }
    // Chooses among the passages with the fewest visits: a near one, with some randomness, away from other
    // robots.
    std::size_t best = routes.passages.size();
    std::size_t best_end = 0;
    double best_cost = std::numeric_limits<double>::infinity();
    const int fewest = *std::min_element(visits.begin(), visits.end());
    for (std::size_t p = 0; p < routes.passages.size(); ++p) {
      if (visits[p] > fewest) continue;
      const auto& passage = routes.passages[p];
      for (const std::size_t end : {passage.from, passage.to}) {
        double cost = (4.0 + ways.between(robot->place, end)) * rng.uniform(0.6, 1.6);
        for (const State& other : team) {
          if (&other != robot && !other.done && !other.legs.empty()) {
            cost += 12.0 * std::exp(-ways.between(other.place, end) / 15.0);
          }
        }
        if (cost < best_cost) {
          best_cost = cost;
          best = p;
          best_end = end;
        }
      }
    }
    go_to(*robot, best_end);
    go(*robot, best);
  }
  std::vector<std::vector<Leg>> result;
  result.reserve(team.size());
  for (State& robot : team) result.push_back(std::move(robot.legs));
  return result;
}

std::vector<Waypoint> drive(const RouteGraph& routes, const std::vector<Leg>& legs,
                            const simulation_parameters::Platform& platform, double spacing_m,
                            std::size_t count, std::uint64_t seed) {
  Rng rng(seed);
  const double phase = rng.uniform(0.0, 1000.0);
  const std::vector<Dense> dense = dense_path(routes, legs, spacing_m, count, phase, seed);
  const std::vector<Eigen::Vector3d> smooth = smoothed(dense);

  std::vector<Waypoint> result;
  const double speed = platform.speed_mps * rng.uniform(0.9, 1.1);
  double driven = 0.0, next = 0.0, time = 0.0, yaw = 0.0;
  for (std::size_t i = 0; i < dense.size() && result.size() < count; ++i) {
    if (i > 0) driven += (smooth[i] - smooth[i - 1]).norm();
    const std::size_t behind = i - std::min<std::size_t>(i, 4), ahead = std::min(i + 4, dense.size() - 1);
    const Eigen::Vector3d direction = smooth[ahead] - smooth[behind];
    if (direction.head<2>().norm() > 0.1) yaw = std::atan2(direction.y(), direction.x());
    if (driven + 1e-9 < next) continue;
    const double slope = std::atan2(direction.z(), std::max(0.2, direction.head<2>().norm()));
    const double roll = platform.tilt_jitter_rad * rng.normal();
    const double pitch = -slope + platform.tilt_jitter_rad * rng.normal();
    const double heading = yaw + 0.7 * platform.tilt_jitter_rad * rng.normal();
    const double lift = platform.lidar_height_m + platform.height_jitter_m * rng.normal();
    const auto angle = [](double a, const Eigen::Vector3d& axis) {
      return Eigen::AngleAxisd(rounded(a, 1e-6), axis);
    };
    Waypoint w;
    w.T_world_body = Eigen::Isometry3d::Identity();
    w.T_world_body.linear() = (angle(heading, Eigen::Vector3d::UnitZ()) *
                               angle(pitch, Eigen::Vector3d::UnitY()) * angle(roll, Eigen::Vector3d::UnitX()))
                                  .toRotationMatrix();
    for (int k = 0; k < 3; ++k) {
      w.T_world_body.translation()[k] = rounded(smooth[i][k] + (k == 2 ? lift : 0.0), 1e-4);
    }
    if (!result.empty()) time += spacing_m / speed * rng.uniform(0.9, 1.15);
    w.time_s = time;
    w.passage = dense[i].passage;
    w.along_m = dense[i].along;
    result.push_back(w);
    next += spacing_m;
  }
  return result;
}

}  // namespace loopwise::simulation_detail
