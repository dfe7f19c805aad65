// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/mission.hpp>

#include "registration/scene.hpp"

namespace loopwise::testing {

/// Robots drive along one yard side by side, there and back, a node every 2 m; scans are what they see. Poses
/// and odometry are true, the keys are those of these robots.
inline Mission yard(const std::vector<char>& robots = {'a', 'b'}) {
  Mission out;
  out.name = "yard";
  const Scene scene(4);
  std::string names;
  auto clouds = std::make_shared<Scans>();
  std::vector<Key> keys;
  for (const char robot : robots) {
    Rng rng(static_cast<std::uint64_t>(robot));
    names += std::string(names.empty() ? "" : ",") + robot;
    for (std::uint64_t i = 0; i < 24; ++i) {
      const double along = i < 12 ? 2.0 * static_cast<double>(i) : 2.0 * static_cast<double>(23 - i);
      Node node;
      node.key = make_key(robot, i);
      node.stamp_ns = static_cast<std::int64_t>(i) * 4000000000;
      node.pose = ground_pose(-11.0 + along, -1.0 + 2.0 * (robot - 'a'), i < 12 ? 0.0 : 3.1);
      out.graph.add_node(node);
      if (i > 0) {
        Edge edge;
        edge.from = node.key - 1;
        edge.to = node.key;
        edge.kind = EdgeKind::kOdometry;
        edge.T_from_to = out.ground_truth.at(node.key - 1).inverse() * node.pose;
        edge.information.diagonal() << Eigen::Vector3d::Constant(400.0), Eigen::Vector3d::Constant(1e4);
        out.graph.add_edge(edge);
      } else {
        PriorFactor prior;
        prior.key = node.key;
        prior.pose = node.pose;
        prior.information = 1e6 * Matrix6d::Identity();
        out.graph.add_prior(prior);
      }
      out.ground_truth[node.key] = node.pose;
      (*clouds)[node.key] = scene.scan(node.pose, 1200, rng);
      keys.push_back(node.key);
    }
  }
  out.robots = parse_robots(names);
  out.scans = std::make_shared<ScanStore>(keys, [clouds](Key key) { return clouds->at(key); });
  return out;
}

}  // namespace loopwise::testing
