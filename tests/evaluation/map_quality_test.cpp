// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/map_quality.hpp>

#include <cmath>
#include <set>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

#include "registration/scene.hpp"
#include "testing.hpp"

namespace loopwise {
namespace {

using testing::Scene;

/// Two robots drive along one yard, there and back, with a node every 2 m; scans are computed from the
/// visible surfaces.
struct Yard {
  Mission mission;
  PosesByKey truth;
};
Yard yard() {
  Yard out;
  const Scene scene(4);
  Rng rng(11);
  out.mission.robots = parse_robots("a,b");
  auto clouds = std::make_shared<testing::Scans>();
  std::vector<Key> keys;
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < 24; ++i) {
      const double along = i < 12 ? 2.0 * static_cast<double>(i) : 2.0 * static_cast<double>(23 - i);
      Node node;
      node.key = make_key(robot, i);
      node.pose = testing::ground_pose(-11.0 + along, robot == 'a' ? -1.0 : 1.0, i < 12 ? 0.0 : 3.1);
      if (i > 0) {
        Edge edge;
        edge.from = node.key - 1;
        edge.to = node.key;
        edge.kind = EdgeKind::kOdometry;
        edge.T_from_to = out.truth.at(node.key - 1).inverse() * node.pose;
        out.mission.graph.add_node(node);
        out.mission.graph.add_edge(edge);
      } else {
        out.mission.graph.add_node(node);
      }
      out.truth[node.key] = node.pose;
      (*clouds)[node.key] = scene.scan(node.pose, 1200, rng);
      keys.push_back(node.key);
    }
  }
  out.mission.scans = std::make_shared<ScanStore>(keys, [clouds](Key key) { return clouds->at(key); });
  return out;
}

/// Odometry that turns by a little with each node.
PosesByKey drifted(const PosesByKey& truth, double m_per_node) {
  PosesByKey poses = truth;
  for (auto& [key, pose] : poses) pose.translation().y() += m_per_node * static_cast<double>(key_index(key));
  return poses;
}

TEST_CASE("map quality: the displacement grows with the error of the poses", "[evaluation][map]") {
  const Yard made = yard();
  ThreadPool pool(2);
  const PosesByKey before = drifted(made.truth, 0.08);
  const MapQuality right = map_quality(made.mission, before, made.truth, {}, {}, pool);
  REQUIRE(right.revisits.size() > 20);
  REQUIRE(right.revisits.size() <= right.pairs);
  CHECK(right.after.median_m < 0.15);  // measured: 0.073, with scans of 2 cm noise
  CHECK(right.before.mean_m > 0.3);
  CHECK(right.difference.mean_difference < -0.3);
  CHECK(right.share_after > right.share_before);
  // The share after registration is the upper bound.
  CHECK(right.share_registered == Approx(right.share_after).margin(0.1));
  CHECK(right.near.proven > right.near.pairs / 2);
  double last = right.after.mean_m;
  for (const double m_per_node : {0.02, 0.05}) {
    const MapQuality worse = map_quality(made.mission, before, drifted(made.truth, m_per_node), {}, {}, pool);
    // Revisits are the same for every estimate.
    REQUIRE(worse.revisits.size() == right.revisits.size());
    CHECK(worse.after.mean_m > last);
    last = worse.after.mean_m;
  }
  ThreadPool one(1);
  CHECK(map_quality(made.mission, before, made.truth, {}, {}, one).after.each_m == right.after.each_m);
}

TEST_CASE("map quality: closures of the estimate do not count as revisits", "[evaluation][map]") {
  const Yard made = yard();
  ThreadPool pool(2);
  const MapQuality all = map_quality(made.mission, made.truth, made.truth, {}, {}, pool);
  CHECK(all.difference.mean_difference == 0.0);
  Revisits used;
  for (std::size_t i = 0; i < all.revisits.size(); i += 2)
    used.emplace_back(all.revisits[i].to, all.revisits[i].from);  // in either order
  const MapQuality some = map_quality(made.mission, made.truth, made.truth, used, {}, pool);
  CHECK(some.pairs == all.pairs - used.size());
  CHECK(some.revisits.size() == all.revisits.size() - used.size());
}

TEST_CASE("map quality: near pairs of different places show robots in a wrong frame", "[evaluation][map]") {
  const Yard made = yard();
  ThreadPool pool(2);
  // The frame of b is turned and moved: its nodes lie on those of a that saw other places.
  PosesByKey merged = made.truth;
  const Eigen::Isometry3d T = se3::exp((Vector6d() << 16.0, 0.0, 0.0, 0.0, 0.0, 0.0).finished());
  for (auto& [key, pose] : merged) {
    if (key >= make_key('b', 0)) pose = T * pose;
  }
  const MapQuality right = map_quality(made.mission, made.truth, made.truth, {}, {}, pool);
  const MapQuality wrong = map_quality(made.mission, made.truth, merged, {}, {}, pool);
  REQUIRE(right.near_between_robots.pairs > 10);
  REQUIRE(wrong.near_between_robots.pairs > 10);
  CHECK(2 * right.near_between_robots.proven > right.near_between_robots.pairs);
  CHECK(right.near_between_robots.median_m < 0.15);
  CHECK((wrong.near_between_robots.proven == 0 || wrong.near_between_robots.median_m > 5.0));
  CHECK(wrong.after.mean_m > 5.0);
}

TEST_CASE("map quality: without revisits there are no figures", "[evaluation][map]") {
  Yard made = yard();
  ThreadPool pool(1);
  PosesByKey apart = made.truth;
  for (auto& [key, pose] : apart)
    pose.translation().x() += 50.0 * static_cast<double>(key_index(key) + 100 * (key >= make_key('b', 0)));
  const MapQuality none = map_quality(made.mission, apart, apart, {}, {}, pool);
  CHECK(none.pairs == 0);
  CHECK(none.revisits.empty());
  CHECK(!none.enough());
  CHECK(std::isnan(none.after.mean_m));
  CHECK(std::isnan(none.share_registered));
}

TEST_CASE("revisits: with drift nodes may be further apart the longer the path between them",
          "[evaluation][surfaces]") {
  const Yard made = yard();
  SurfaceAgreementOptions options;
  const std::size_t narrow = find_revisits(made.mission, made.truth, options).size();
  options.drift = 0.1;
  const Revisits wide = find_revisits(made.mission, made.truth, options);
  CHECK(wide.size() > narrow);
  options.reach_most_m = 1.0;  // never narrower than reach_m
  CHECK(find_revisits(made.mission, made.truth, options).size() == narrow);
}

}  // namespace
}  // namespace loopwise
