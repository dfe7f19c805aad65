// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/surface_agreement.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {
namespace {

struct PathNode {
  Key key;
  std::size_t robot;
  double along_m;  ///< Path of its robot so far.
  Eigen::Vector3d position;
};

/// The nodes that have a pose and a scan, each robot's in the order of its path.
std::vector<PathNode> path_nodes(const Mission& mission, const PosesByKey& poses) {
  std::vector<PathNode> nodes;
  for (const Node& node : mission.graph.nodes()) {
    const auto pose = poses.find(node.key);
    if (mission.robots.is_landmark(node.key) || pose == poses.end() || !mission.scans->has(node.key))
      continue;
    nodes.push_back({node.key, mission.robots.of(node.key), 0.0, pose->second.translation()});
  }
  std::sort(nodes.begin(), nodes.end(), [](const PathNode& a, const PathNode& b) {
    return std::pair(a.robot, a.key) < std::pair(b.robot, b.key);
  });
  for (std::size_t i = 1; i < nodes.size(); ++i) {
    if (nodes[i].robot != nodes[i - 1].robot) continue;
    nodes[i].along_m = nodes[i - 1].along_m + (nodes[i].position - nodes[i - 1].position).norm();
  }
  return nodes;
}

/// Path between two nodes, m: along the path of their robot, or along both paths from their starts, which
/// share a frame. Nodes with a short path between them are no evidence on a map, and neither are robots side
/// by side at the start.
double loop_m(const PathNode& a, const PathNode& b) {
  return a.robot == b.robot ? std::abs(a.along_m - b.along_m) : a.along_m + b.along_m;
}

/// Maximum distance of two nodes of a revisit.
double reach_m(const SurfaceAgreementOptions& options, double loop_m) {
  return std::max(options.reach_m, std::min(options.reach_m + options.drift * loop_m, options.reach_most_m));
}

/// Nodes in cells of the size of the reach.
class NearNodes {
 public:
  NearNodes(const std::vector<PathNode>& nodes, double reach_m) : nodes_(nodes), reach_m_(reach_m) {
    for (std::size_t i = 0; i < nodes.size(); ++i) cells_[cell_of(nodes[i].position)].push_back(i);
  }

  /// Calls visit(nodes[i], nodes[j]) for all pairs in reach, j < i, in the order of i, then j.
  template <class Visitor>
  void for_each_pair(Visitor&& visit) const {
    std::vector<std::size_t> others;
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      others.clear();
      const Cell own = cell_of(nodes_[i].position);
      for (int n = 0; n < 27; ++n) {
        const auto cell = cells_.find({own[0] + n % 3 - 1, own[1] + n / 3 % 3 - 1, own[2] + n / 9 - 1});
        if (cell == cells_.end()) continue;
        for (const std::size_t j : cell->second) {
          if (j < i && (nodes_[i].position - nodes_[j].position).norm() <= reach_m_) others.push_back(j);
        }
      }
      std::sort(others.begin(), others.end());
      for (const std::size_t j : others) visit(nodes_[i], nodes_[j]);
    }
  }

 private:
  using Cell = std::array<std::int64_t, 3>;
  [[nodiscard]] Cell cell_of(const Eigen::Vector3d& p) const {
    constexpr double kLimit = 1e15;  // keeps the cast defined
    Cell cell{};
    for (int axis = 0; axis < 3; ++axis)
      cell[static_cast<std::size_t>(axis)] =
          static_cast<std::int64_t>(std::clamp(std::floor(p[axis] / reach_m_), -kLimit, kLimit));
    return cell;
  }

  const std::vector<PathNode>& nodes_;
  double reach_m_;
  std::map<Cell, std::vector<std::size_t>> cells_;
};

/// Whether two nodes are near each other with enough path between them.
bool is_revisit(const PathNode& a, const PathNode& b, const SurfaceAgreementOptions& options) {
  const double loop = loop_m(a, b);
  return loop >= options.apart_m && (a.position - b.position).norm() <= reach_m(options, loop);
}

/// Selects options.pairs of the pairs that `is_wanted` accepts, evenly: the middle one of each of as many
/// equal parts.
template <class IsWanted>
Revisits drawn_pairs(const std::vector<PathNode>& nodes, const SurfaceAgreementOptions& options,
                     IsWanted&& is_wanted) {
  const double most_m =
      options.drift > 0.0 ? std::max(options.reach_m, options.reach_most_m) : options.reach_m;
  const NearNodes near(nodes, most_m);
  std::size_t count = 0;
  near.for_each_pair([&](const PathNode& a, const PathNode& b) { count += is_wanted(a, b) ? 1 : 0; });
  const std::size_t wanted = std::min(count, static_cast<std::size_t>(options.pairs));
  Revisits drawn;
  std::size_t rank = 0;
  near.for_each_pair([&](const PathNode& a, const PathNode& b) {
    if (drawn.size() == wanted || !is_wanted(a, b)) return;
    if (rank++ == (2 * drawn.size() + 1) * count / (2 * wanted)) drawn.emplace_back(a.key, b.key);
  });
  return drawn;
}

/// A robot and the number of a stretch of its path.
using Stretch = std::pair<std::size_t, double>;

std::map<Key, Stretch> stretches_by_key(const Mission& mission, const PosesByKey& poses, double stretch_m) {
  if (!(stretch_m > 0.0)) throw OptionError("stretch_m = " + std::to_string(stretch_m) + ", must be > 0");
  std::map<Key, Stretch> stretches;
  for (const PathNode& node : path_nodes(mission, poses))
    stretches[node.key] = {node.robot, std::floor(node.along_m / stretch_m)};
  return stretches;
}

/// Share of a's points with a point of b near them.
double share_on(const PointCloud& a, const KdTree& b, const Eigen::Isometry3f& T_b_a,
                const SurfaceAgreementOptions& options) {
  const std::size_t stride = 1 + (a.size() - 1) / static_cast<std::size_t>(options.points);
  std::size_t on = 0, looked_at = 0;
  for (std::size_t i = 0; i < a.size(); i += stride, ++looked_at) {
    on += b.nearest(T_b_a * a.points[i], static_cast<float>(options.near_m)) ? 1 : 0;
  }
  return static_cast<double>(on) / static_cast<double>(looked_at);
}

/// A scan with its search tree.
struct Surface {
  std::shared_ptr<const PointCloud> cloud;
  KdTree tree;
};

Surface surface_of(const ScanStore& scans, Key key) {
  Surface surface;
  try {
    surface.cloud = scans.load(key);
  } catch (const Error&) {
    // The store has counted the problem.
  }
  if (surface.cloud && surface.cloud->empty()) surface.cloud = nullptr;
  if (surface.cloud) surface.tree = KdTree(surface.cloud->points);
  return surface;
}

}  // namespace

Revisits find_revisits(const Mission& mission, const PosesByKey& poses,
                       const SurfaceAgreementOptions& options) {
  validate(options);
  const std::vector<PathNode> nodes = path_nodes(mission, poses);
  return drawn_pairs(nodes, options,
                     [&](const PathNode& a, const PathNode& b) { return is_revisit(a, b, options); });
}

Revisits find_new_revisits(const Mission& mission, const PosesByKey& poses,
                           const SurfaceAgreementOptions& options, const PosesByKey& former,
                           const SurfaceAgreementOptions& of_former) {
  validate(options);
  validate(of_former);
  const std::vector<PathNode> nodes = path_nodes(mission, poses);
  std::map<Key, PathNode> places;
  for (const PathNode& node : path_nodes(mission, former)) places.emplace(node.key, node);
  return drawn_pairs(nodes, options, [&](const PathNode& a, const PathNode& b) {
    if (!is_revisit(a, b, options)) return false;
    const auto former_a = places.find(a.key), former_b = places.find(b.key);
    return former_a == places.end() || former_b == places.end() ||
           !is_revisit(former_a->second, former_b->second, of_former);
  });
}

double revisited_share(const Mission& mission, const PosesByKey& poses, const Revisits& revisits,
                       double stretch_m) {
  const std::map<Key, Stretch> stretches = stretches_by_key(mission, poses, stretch_m);
  std::set<Stretch> all, revisited;
  for (const auto& [key, stretch] : stretches) all.insert(stretch);
  for (const auto& [from, to] : revisits) {
    for (const Key key : {from, to}) {
      if (const auto found = stretches.find(key); found != stretches.end()) revisited.insert(found->second);
    }
  }
  return all.empty() ? std::numeric_limits<double>::quiet_NaN()
                     : static_cast<double>(revisited.size()) / static_cast<double>(all.size());
}

std::vector<std::size_t> revisit_groups(const Mission& mission, const PosesByKey& poses,
                                        const Revisits& revisits, double stretch_m) {
  const std::map<Key, Stretch> stretches = stretches_by_key(mission, poses, stretch_m);
  std::map<std::pair<Stretch, Stretch>, std::size_t> numbers;
  std::vector<std::size_t> groups;
  for (const auto& [from, to] : revisits) {
    const auto a = stretches.find(from), b = stretches.find(to);
    if (a == stretches.end() || b == stretches.end()) {
      throw InputError("revisit of " + key_name(from) + " and " + key_name(to) +
                       ": a pose or a scan is missing");
    }
    groups.push_back(numbers.emplace(std::minmax(a->second, b->second), numbers.size()).first->second);
  }
  return groups;
}

SurfaceAgreement surface_agreement(const Mission& mission, const PosesByKey& poses, const Revisits& revisits,
                                   const SurfaceAgreementOptions& options, const StopToken& stop) {
  validate(options);
  SurfaceAgreement agreement;
  double sum = 0.0;
  for (const auto& [from, to] : revisits) {
    agreement.shares.push_back(std::numeric_limits<double>::quiet_NaN());
    const auto pose_from = poses.find(from), pose_to = poses.find(to);
    if (stop.stop_requested() || pose_from == poses.end() || pose_to == poses.end()) continue;
    const Surface a = surface_of(*mission.scans, from), b = surface_of(*mission.scans, to);
    if (!a.cloud || !b.cloud) continue;
    const Eigen::Isometry3d T_to_from = pose_to->second.inverse() * pose_from->second;
    agreement.shares.back() = 0.5 * (share_on(*a.cloud, b.tree, T_to_from.cast<float>(), options) +
                                     share_on(*b.cloud, a.tree, T_to_from.inverse().cast<float>(), options));
    sum += agreement.shares.back();
    ++agreement.revisits;
  }
  agreement.mean = agreement.revisits > 0 ? sum / static_cast<double>(agreement.revisits)
                                          : std::numeric_limits<double>::quiet_NaN();
  return agreement;
}

}  // namespace loopwise
