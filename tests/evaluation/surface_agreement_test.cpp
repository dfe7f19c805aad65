// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/surface_agreement.hpp>

#include <cmath>

#include <loopwise/core/random.hpp>

#include "testing.hpp"

namespace loopwise {
namespace {

/// One robot drives the same straight line twice past two walls; scans are what it sees within 15 m.
Mission twice_past_walls() {
  Mission mission;
  mission.robots = parse_robots("a");
  std::vector<Eigen::Vector3d> walls;
  Rng rng(3);
  for (int i = 0; i < 12000; ++i) {
    walls.emplace_back(rng.uniform(-15.0, 55.0),
                       (i % 2 == 0 ? 3.0 : -4.0) + std::sin(0.7 * rng.uniform(0.0, 9.0)),
                       rng.uniform(0.0, 3.0));
  }
  std::vector<Key> keys;
  for (std::uint64_t i = 0; i < 40; ++i) {
    Node node;
    node.key = make_key('a', i);
    node.pose.translation() =
        Eigen::Vector3d(i < 20 ? 2.0 * static_cast<double>(i) : 2.0 * static_cast<double>(39 - i), 0.0, 1.0);
    mission.graph.add_node(node);
    mission.ground_truth[node.key] = node.pose;
    keys.push_back(node.key);
  }
  mission.scans = std::make_shared<ScanStore>(keys, [walls, truth = mission.ground_truth](Key key) {
    auto cloud = std::make_shared<PointCloud>();
    for (const Eigen::Vector3d& wall : walls) {
      const Eigen::Vector3d p = truth.at(key).inverse() * wall;
      if (p.norm() < 15.0) cloud->points.push_back(p.cast<float>());
    }
    return cloud;
  });
  return mission;
}

PosesByKey shifted(PosesByKey poses, double side_m) {
  for (auto& [key, pose] : poses) {
    if (key >= make_key('a', 20)) pose.translation().y() += side_m;
  }
  return poses;
}

}  // namespace

TEST_CASE("surface agreement: right poses agree, wrong ones less the wronger they are",
          "[evaluation][surfaces]") {
  const Mission mission = twice_past_walls();
  const Revisits revisits = find_revisits(mission, mission.ground_truth);
  REQUIRE(revisits.size() > 20);
  for (const auto& [from, to] : revisits) {
    REQUIRE(
        (mission.ground_truth.at(from).translation() - mission.ground_truth.at(to).translation()).norm() <=
        3.0);
  }
  const SurfaceAgreement right = surface_agreement(mission, mission.ground_truth, revisits);
  REQUIRE(right.revisits == revisits.size());
  REQUIRE(right.mean > 0.9);  // ends of the sight lack a partner
  double before = right.mean;
  for (const double off_m : {0.1, 0.4, 1.5}) {
    const double now = surface_agreement(mission, shifted(mission.ground_truth, off_m), revisits).mean;
    REQUIRE(now < before);
    before = now;
  }
  // It does not depend on the frame.
  PosesByKey turned;
  const Eigen::Isometry3d T = se3::exp((Vector6d() << 5.0, -7.0, 2.0, 0.1, -0.2, 2.0).finished());
  for (const auto& [key, pose] : mission.ground_truth) turned[key] = T * pose;
  REQUIRE(surface_agreement(mission, turned, revisits).mean == Approx(right.mean).margin(0.01));
}

TEST_CASE("surface agreement: what is missing is left out", "[evaluation][surfaces]") {
  const Mission mission = twice_past_walls();
  SurfaceAgreementOptions options;
  options.pairs = 7;
  const Revisits revisits = find_revisits(mission, mission.ground_truth, options);
  REQUIRE(revisits.size() == 7);
  PosesByKey some = mission.ground_truth;
  some.erase(revisits.front().first);
  const SurfaceAgreement agreement = surface_agreement(mission, some, revisits, options);
  REQUIRE(agreement.shares.size() == 7);
  REQUIRE(std::isnan(agreement.shares.front()));
  REQUIRE(agreement.revisits < 7);
  options.apart_m = 1000.0;
  REQUIRE(find_revisits(mission, mission.ground_truth, options).empty());
  REQUIRE(std::isnan(surface_agreement(mission, some, {}, options).mean));
  options.near_m = 0.0;
  REQUIRE_THROWS_AS(find_revisits(mission, mission.ground_truth, options), OptionError);
}

}  // namespace loopwise
