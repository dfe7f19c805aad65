// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/surface_agreement.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

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
    // The store keeps it among its problems.
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
  Revisits all;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if ((nodes[i].position - nodes[j].position).norm() > options.reach_m) continue;
      if (nodes[i].robot == nodes[j].robot && nodes[i].along_m - nodes[j].along_m < options.apart_m) continue;
      all.emplace_back(nodes[i].key, nodes[j].key);
    }
  }
  const auto wanted = static_cast<std::size_t>(options.pairs);
  if (all.size() <= wanted) return all;
  Revisits drawn;
  for (std::size_t k = 0; k < wanted; ++k) drawn.push_back(all[(2 * k + 1) * all.size() / (2 * wanted)]);
  return drawn;
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
