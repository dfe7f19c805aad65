// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/statistics.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <loopwise/core/random.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/features/kd_tree.hpp>
#include <loopwise/features/normals.hpp>
#include <loopwise/features/observability.hpp>

namespace loopwise {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Quartiles quartiles(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const auto at = [&values](double share) {
    if (values.empty()) return kNan;
    return values[static_cast<std::size_t>(std::lround(share * static_cast<double>(values.size() - 1)))];
  };
  return {values.size(), at(0.25), at(0.5), at(0.75)};
}

}  // namespace

std::vector<RobotDrift> odometry_drift(const Mission& mission) {
  std::vector<std::vector<Key>> own(mission.robots.size());
  for (const Node& node : mission.graph.nodes()) {
    if (mission.ground_truth.count(node.key) != 0) own[mission.robots.of(node.key)].push_back(node.key);
  }
  std::vector<RobotDrift> result;
  for (std::size_t r = 0; r < own.size(); ++r) {
    std::sort(own[r].begin(), own[r].end());
    if (own[r].size() < 2) continue;
    RobotDrift drift;
    drift.robot = mission.robots[r].name;
    const Eigen::Isometry3d T_truth_estimate =
        mission.ground_truth.at(own[r][0]) * mission.graph.node(own[r][0]).pose.inverse();
    for (std::size_t k = 1; k < own[r].size(); ++k) {
      const Eigen::Isometry3d& truth = mission.ground_truth.at(own[r][k]);
      drift.length_m += (truth.translation() - mission.ground_truth.at(own[r][k - 1]).translation()).norm();
      const Eigen::Isometry3d error = truth.inverse() * T_truth_estimate * mission.graph.node(own[r][k]).pose;
      drift.end_m = error.translation().norm();
      drift.largest_m = std::max(drift.largest_m, drift.end_m);
      drift.largest_rad = std::max(drift.largest_rad, se3::rotation_angle(error));
    }
    result.push_back(std::move(drift));
  }
  return result;
}

CandidateStatistics candidate_statistics(const Mission& mission, const CandidateStatisticsOptions& options) {
  validate(options);
  // In the order of arrival, so that the newer node of a pair is known.
  std::vector<const Node*> nodes;
  for (const Node& node : mission.graph.nodes()) nodes.push_back(&node);
  std::sort(nodes.begin(), nodes.end(), [](const Node* a, const Node* b) {
    return std::pair(a->stamp_ns, a->key) < std::pair(b->stamp_ns, b->key);
  });
  std::vector<std::size_t> robot(nodes.size());
  std::vector<std::uint64_t> index(nodes.size());
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    robot[i] = mission.robots.of(nodes[i]->key);
    index[i] = mission.robots.node_index(nodes[i]->key);
  }

  CandidateStatistics result;
  std::vector<std::pair<std::size_t, std::size_t>>
      chosen;  // a uniform sample of a stream (Vitter's algorithm R)
  Rng rng(0x5eed);
  const double sq_radius = options.radius_m * options.radius_m;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const Eigen::Vector3d here = nodes[i]->pose.translation();
    for (std::size_t j = 0; j < i; ++j) {
      if ((nodes[j]->pose.translation() - here).squaredNorm() > sq_radius) continue;
      const std::uint64_t gap = index[i] > index[j] ? index[i] - index[j] : index[j] - index[i];
      if (robot[i] == robot[j] && gap < static_cast<std::uint64_t>(options.skip_recent)) continue;
      ++result.candidates;
      if (chosen.size() < static_cast<std::size_t>(options.pairs)) {
        chosen.emplace_back(i, j);
      } else if (const std::uint64_t at = rng.below(result.candidates); at < chosen.size()) {
        chosen[at] = {i, j};
      }
    }
  }

  struct Seen {
    bool valid = false;
    bool near = false;
    double overlap = 0.0;
  };
  std::vector<Seen> seen(chosen.size());
  ThreadPool pool(options.threads);
  pool.for_each(chosen.size(), [&](std::size_t c) {
    const Key from = nodes[chosen[c].first]->key, to = nodes[chosen[c].second]->key;
    const auto truth_from = mission.ground_truth.find(from), truth_to = mission.ground_truth.find(to);
    if (truth_from == mission.ground_truth.end() || truth_to == mission.ground_truth.end()) return;
    const auto source = mission.scans->load(from), target = mission.scans->load(to);
    if (!source || !target || source->empty() || target->empty()) return;
    const Eigen::Isometry3d relative = truth_to->second.inverse() * truth_from->second;
    const Eigen::Isometry3f T_to_from = relative.cast<float>();
    const KdTree tree(target->points);
    std::size_t shared = 0;
    for (const Eigen::Vector3f& p : source->points) {
      if (tree.nearest(T_to_from * p, static_cast<float>(options.near_m))) ++shared;
    }
    seen[c] = {true, relative.translation().norm() <= options.radius_m,
               static_cast<double>(shared) / static_cast<double>(source->size())};
  });
  std::size_t overlapping = 0, near = 0;
  double sum = 0.0;
  for (const Seen& s : seen) {
    if (!s.valid) continue;
    ++result.looked_at;
    sum += s.overlap;
    if (s.overlap >= options.min_overlap) ++overlapping;
    if (s.near) ++near;
  }
  const auto count = static_cast<double>(result.looked_at);
  result.mean_overlap = result.looked_at > 0 ? sum / count : kNan;
  result.overlapping = result.looked_at > 0 ? static_cast<double>(overlapping) / count : kNan;
  result.within_radius = result.looked_at > 0 ? static_cast<double>(near) / count : kNan;
  return result;
}

SensorStatistics sensor_statistics(const SimulatedMission& made, int threads) {
  SensorStatistics result;
  const auto& nodes = made.mission.graph.nodes();
  std::vector<double> score(nodes.size(), 0.0);
  ThreadPool pool(threads);
  pool.for_each(nodes.size(), [&](std::size_t i) {
    const auto cloud = made.mission.scans->load(nodes[i].key);
    if (!cloud || cloud->size() < 10) return;
    PointCloud with_normals{cloud->points, estimate_normals(cloud->points, KdTree(cloud->points), 10), {}};
    score[i] = observability(with_normals).min_eigenvalue;
  });
  const double largest = score.empty() ? 0.0 : *std::max_element(score.begin(), score.end());
  std::vector<double> corridors, elsewhere;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    (made.in_corridor[i] ? corridors : elsewhere).push_back(largest > 0.0 ? score[i] / largest : 0.0);
  }
  result.corridors = quartiles(std::move(corridors));
  result.elsewhere = quartiles(std::move(elsewhere));

  const std::array<double, 9> edges{0.0, 5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0};
  for (const bool walls : {false, true}) {
    for (std::size_t e = 1; e < edges.size(); ++e) {
      PowerBin bin;
      bin.from_m = edges[e - 1];
      bin.to_m = edges[e];
      bin.walls = walls;
      double sum = 0.0, squares = 0.0;
      for (std::size_t i = 0; i < made.readings.size(); ++i) {
        const ReadingTruth& truth = made.readings[i];
        if (truth.distance_m < bin.from_m || truth.distance_m >= bin.to_m || (truth.walls > 0) != walls)
          continue;
        const double power = made.mission.radio[i].receive_dbm;
        if (std::isnan(power)) {
          ++bin.missed;
          continue;
        }
        ++bin.heard;
        sum += power;
        squares += power * power;
      }
      const auto count = static_cast<double>(bin.heard);
      bin.mean_dbm = bin.heard > 0 ? sum / count : kNan;
      bin.sigma_db =
          bin.heard > 0 ? std::sqrt(std::max(0.0, squares / count - bin.mean_dbm * bin.mean_dbm)) : kNan;
      result.power.push_back(bin);
    }
  }
  return result;
}

}  // namespace loopwise
