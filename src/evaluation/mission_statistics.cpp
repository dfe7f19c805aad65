// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/mission_statistics.hpp>

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

std::vector<RobotDrift> odometry_drift(const Mission& mission) {
  std::vector<std::vector<Key>> own(mission.robots.size());
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.is_landmark(node.key)) continue;
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

namespace {

/// Places of a candidate's nodes, the newer first.
using IndexPair = std::pair<std::size_t, std::size_t>;

/// Properties of a candidate by the truth and by its scans.
struct Seen {
  bool valid = false;
  bool near = false;
  double overlap = 0.0;
};

/// All nodes but landmarks in the order of arrival, so that the newer node of a pair is known.
std::vector<const Node*> by_arrival(const Mission& mission) {
  std::vector<const Node*> nodes;
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.robots.is_landmark(node.key)) nodes.push_back(&node);
  }
  std::sort(nodes.begin(), nodes.end(), [](const Node* a, const Node* b) {
    return std::pair(a->stamp_ns, a->key) < std::pair(b->stamp_ns, b->key);
  });
  return nodes;
}

/// A uniform sample of all candidates (Vitter's algorithm R), and their number.
std::vector<IndexPair> draw_pairs(const Mission& mission, const std::vector<const Node*>& nodes,
                                  const CandidateStatisticsOptions& options, std::uint64_t& candidates) {
  std::vector<std::size_t> robot(nodes.size());
  std::vector<std::uint64_t> index(nodes.size());
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    robot[i] = mission.robots.of(nodes[i]->key);
    index[i] = mission.robots.node_index(nodes[i]->key);
  }
  std::vector<IndexPair> chosen;
  Rng rng(0x5eed);
  const double sq_radius = options.radius_m * options.radius_m;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const Eigen::Vector3d here = nodes[i]->pose.translation();
    for (std::size_t j = 0; j < i; ++j) {
      if ((nodes[j]->pose.translation() - here).squaredNorm() > sq_radius) continue;
      const std::uint64_t gap = index[i] > index[j] ? index[i] - index[j] : index[j] - index[i];
      if (robot[i] == robot[j] && gap < static_cast<std::uint64_t>(options.skip_recent)) continue;
      ++candidates;
      if (chosen.size() < static_cast<std::size_t>(options.pairs)) {
        chosen.emplace_back(i, j);
      } else if (const std::uint64_t at = rng.below(candidates); at < chosen.size()) {
        chosen[at] = {i, j};
      }
    }
  }
  return chosen;
}

Seen look_at(const Mission& mission, Key from, Key to, const CandidateStatisticsOptions& options) {
  const auto truth_from = mission.ground_truth.find(from), truth_to = mission.ground_truth.find(to);
  if (truth_from == mission.ground_truth.end() || truth_to == mission.ground_truth.end()) return {};
  std::shared_ptr<const PointCloud> source, target;
  try {
    source = mission.scans->load(from);
    target = mission.scans->load(to);
  } catch (const Error&) {
    return {};  // the store has counted the problem
  }
  if (!source || !target || source->empty() || target->empty()) return {};
  const Eigen::Isometry3d relative = truth_to->second.inverse() * truth_from->second;
  const Eigen::Isometry3f T_to_from = relative.cast<float>();
  const KdTree tree(target->points);
  // Some points of a sweep are enough to estimate the share.
  constexpr std::size_t kMostQueries = 2000;
  const std::size_t stride = 1 + (source->size() - 1) / kMostQueries;
  std::size_t shared = 0, queries = 0;
  for (std::size_t i = 0; i < source->size(); i += stride, ++queries) {
    if (tree.nearest(T_to_from * source->points[i], static_cast<float>(options.near_m))) ++shared;
  }
  return {true, relative.translation().norm() <= options.radius_m,
          static_cast<double>(shared) / static_cast<double>(queries)};
}

}  // namespace

CandidateStatistics candidate_statistics(const Mission& mission, const CandidateStatisticsOptions& options) {
  validate(options);
  CandidateStatistics result;
  const std::vector<const Node*> nodes = by_arrival(mission);
  std::uint64_t candidates = 0;
  const std::vector<IndexPair> chosen = draw_pairs(mission, nodes, options, candidates);
  result.candidates = candidates;
  std::vector<Seen> seen(chosen.size());
  ThreadPool pool(options.threads);
  pool.for_each(chosen.size(), [&](std::size_t c) {
    seen[c] = look_at(mission, nodes[chosen[c].first]->key, nodes[chosen[c].second]->key, options);
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
  const auto share = [&](double of) {
    return result.looked_at > 0 ? of / count : std::numeric_limits<double>::quiet_NaN();
  };
  result.mean_overlap = share(sum);
  result.overlapping = share(static_cast<double>(overlapping));
  result.within_radius = share(static_cast<double>(near));
  return result;
}

}  // namespace loopwise
