// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/surface_agreement.hpp>

#include <algorithm>
#include <cmath>

#include <loopwise/core/random.hpp>

#include "testing.hpp"

namespace loopwise::surface_agreement_test {
namespace {

/// One robot drives the same straight line twice past two walls; scans are the visible points within 15 m.
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

TEST_CASE("surface agreement: right poses agree, larger errors agree less", "[evaluation][surfaces]") {
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

TEST_CASE("surface agreement: revisits equal those of a search of all pairs", "[evaluation][surfaces]") {
  Mission mission = twice_past_walls();
  Rng rng(4);
  // Far from the origin and below it, where cells have negative numbers.
  for (auto& [key, pose] : mission.ground_truth) {
    pose.translation() +=
        Eigen::Vector3d(-2.0e5, 7.0, -3.0) +
        Eigen::Vector3d(rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0));
  }
  std::vector<double> along{0.0};
  for (std::uint64_t i = 1; i < 40; ++i) {
    along.push_back(along.back() + (mission.ground_truth.at(make_key('a', i)).translation() -
                                    mission.ground_truth.at(make_key('a', i - 1)).translation())
                                       .norm());
  }
  Revisits expected;
  for (std::uint64_t i = 0; i < 40; ++i) {
    for (std::uint64_t j = 0; j < i; ++j) {
      const Key a = make_key('a', i), b = make_key('a', j);
      if ((mission.ground_truth.at(a).translation() - mission.ground_truth.at(b).translation()).norm() <=
              3.0 &&
          along[i] - along[j] >= 20.0)
        expected.emplace_back(a, b);
    }
  }
  REQUIRE(expected.size() > 10);
  REQUIRE(find_revisits(mission, mission.ground_truth) == expected);
  SurfaceAgreementOptions options;
  options.pairs = 4;
  const Revisits some = find_revisits(mission, mission.ground_truth, options);
  REQUIRE(some.size() == 4);
  for (std::size_t k = 0; k < 4; ++k) REQUIRE(some[k] == expected[(2 * k + 1) * expected.size() / 8]);
}

TEST_CASE("surface agreement: robots side by side at the start are no revisit", "[evaluation][surfaces]") {
  // Two robots drive 60 m together; their odometry can differ once they have driven a while.
  Mission mission;
  mission.robots = parse_robots("a,b");
  std::vector<Key> keys;
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < 30; ++i) {
      Node node;
      node.key = make_key(robot, i);
      node.pose.translation() = Eigen::Vector3d(2.0 * static_cast<double>(i), robot == 'a' ? 0.0 : 1.0, 0.0);
      mission.graph.add_node(node);
      mission.ground_truth[node.key] = node.pose;
      keys.push_back(node.key);
    }
  }
  mission.scans = std::make_shared<ScanStore>(keys, [](Key) { return std::make_shared<PointCloud>(); });
  const Revisits revisits = find_revisits(mission, mission.ground_truth);
  REQUIRE(revisits.size() > 40);
  for (const auto& [from, to] : revisits) REQUIRE(2 * (key_index(from) + key_index(to)) >= 20);

  // Ten stretches of 20 m would be too fine; three of each robot, and those that touch.
  const std::vector<std::size_t> groups = revisit_groups(mission, mission.ground_truth, revisits);
  REQUIRE(groups.size() == revisits.size());
  REQUIRE(*std::max_element(groups.begin(), groups.end()) < 9);
  for (std::size_t i = 0; i < groups.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const auto stretches = [&](std::size_t k) {
        return std::pair(key_index(revisits[k].first) / 10, key_index(revisits[k].second) / 10);
      };
      REQUIRE((groups[i] == groups[j]) == (stretches(i) == stretches(j)));
    }
  }
  REQUIRE_THROWS_AS(revisit_groups(mission, {}, revisits), InputError);
  REQUIRE_THROWS_AS(revisit_groups(mission, mission.ground_truth, revisits, 0.0), OptionError);
}

TEST_CASE("surface agreement: missing scans are left out", "[evaluation][surfaces]") {
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

}  // namespace loopwise::surface_agreement_test
