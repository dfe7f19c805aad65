// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/mission.hpp>

#include "registration/scene.hpp"
#include "testing.hpp"

namespace loopwise::testing {

/// Two robots pass through one yard; a node every 2 m, noisy odometry, the second one's path beside the
/// first's.
inline Mission small_mission(std::uint64_t nodes = 8, std::uint64_t seed = 9) {
  const Scene scene(4);
  Rng rng(seed);
  Mission mission;
  mission.name = "yard";
  mission.robots = parse_robots("a,b");
  auto clouds = std::make_shared<Scans>();
  std::vector<Key> keys;
  for (const char robot : {'a', 'b'}) {
    Eigen::Isometry3d drifted = Eigen::Isometry3d::Identity();
    for (std::uint64_t i = 0; i < nodes; ++i) {
      const Key key = make_key(robot, i);
      const Eigen::Isometry3d truth = ground_pose(-8.0 + 2.0 * static_cast<double>(i),
                                                  robot == 'a' ? -1.0 : 1.5, robot == 'a' ? 0.02 : -0.05);
      Node node;
      node.key = key;
      node.stamp_ns = static_cast<std::int64_t>(i) * 4000000000 + (robot == 'a' ? 0 : 1000000000);
      if (i == 0) {
        drifted = truth;
      } else {
        Vector6d noise;
        for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0.0, k < 3 ? 0.05 : 0.01);
        Edge edge;
        edge.from = key - 1;
        edge.to = key;
        edge.T_from_to = mission.ground_truth.at(key - 1).inverse() * truth * se3::exp(noise);
        edge.kind = EdgeKind::kOdometry;
        edge.information.diagonal() << Eigen::Vector3d::Constant(400.0), Eigen::Vector3d::Constant(1e4);
        drifted = se3::normalized(drifted * edge.T_from_to);
        node.pose = drifted;
        mission.graph.add_node(node);
        mission.graph.add_edge(edge);
      }
      if (i == 0) {
        node.pose = drifted;
        mission.graph.add_node(node);
        PriorFactor prior;
        prior.key = key;
        prior.pose = drifted;
        prior.information = 1e6 * Matrix6d::Identity();
        mission.graph.add_prior(prior);
      }
      mission.ground_truth[key] = truth;
      (*clouds)[key] = scene.scan(truth, 1200, rng);
      keys.push_back(key);
    }
  }
  mission.scans = std::make_shared<ScanStore>(keys, [clouds](Key key) { return clouds->at(key); });
  return mission;
}

}  // namespace loopwise::testing
