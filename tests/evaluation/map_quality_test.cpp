// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/map_quality.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/json_options.hpp>

#include "evaluation/yard.hpp"
#include "testing.hpp"

namespace loopwise::map_quality_test {
namespace {

using testing::yard;

/// Odometry that turns by a little with each node.
PosesByKey drifted(const PosesByKey& truth, double m_per_node) {
  PosesByKey poses = truth;
  for (auto& [key, pose] : poses) pose.translation().y() += m_per_node * static_cast<double>(key_index(key));
  return poses;
}

TEST_CASE("map quality: the displacement grows with the error of the poses", "[evaluation][map]") {
  const Mission made = yard();
  ThreadPool pool(2);
  const PosesByKey before = drifted(made.ground_truth, 0.08);
  const MapQuality right = map_quality(made, before, made.ground_truth, {}, {}, pool);
  REQUIRE(right.revisits.size() > 20);
  REQUIRE(right.revisits.size() <= right.pairs);
  CHECK(right.after.median_m < 0.15);  // measured: 0.073, with scans of 2 cm noise
  CHECK(right.before.mean_m > 0.3);
  CHECK(right.difference.mean_difference < -0.3);
  CHECK(right.share_after > right.share_before);
  // The share after registration is the upper bound.
  CHECK(right.share_registered == Approx(right.share_after).margin(0.1));
  // The recording knows nearly all of these places as well.
  CHECK(right.near.pairs < 10);
  CHECK(right.coverage > 0.9);
  CHECK(right.enough());
  CHECK(right.not_meaningful().empty());
  double last = right.after.mean_m;
  for (const double m_per_node : {0.02, 0.05}) {
    const MapQuality worse = map_quality(made, before, drifted(made.ground_truth, m_per_node), {}, {}, pool);
    // Revisits are the same for every estimate.
    REQUIRE(worse.revisits.size() == right.revisits.size());
    CHECK(worse.after.mean_m > last);
    last = worse.after.mean_m;
  }
  ThreadPool one(1);
  CHECK(map_quality(made, before, made.ground_truth, {}, {}, one).after.each_m == right.after.each_m);
}

TEST_CASE("map quality: closures of the estimate do not count as revisits", "[evaluation][map]") {
  const Mission made = yard();
  ThreadPool pool(2);
  const MapQuality all = map_quality(made, made.ground_truth, made.ground_truth, {}, {}, pool);
  CHECK(all.difference.mean_difference == 0.0);
  Revisits used;
  for (std::size_t i = 0; i < all.revisits.size(); i += 2)
    used.emplace_back(all.revisits[i].to, all.revisits[i].from);  // in either order
  const MapQuality some = map_quality(made, made.ground_truth, made.ground_truth, used, {}, pool);
  CHECK(some.pairs == all.pairs - used.size());
  CHECK(some.revisits.size() == all.revisits.size() - used.size());
}

/// The frame of one robot is moved: its nodes lie on those of others that saw other places.
PosesByKey with_moved_robot(PosesByKey poses, char robot, double x_m) {
  for (auto& [key, pose] : poses) {
    if (key_character(key) == robot) pose.translation().x() += x_m;
  }
  return poses;
}

TEST_CASE("map quality: robots in a wrong frame show by places that are not alike", "[evaluation][map]") {
  const Mission made = yard();
  ThreadPool pool(2);
  const PosesByKey merged = with_moved_robot(made.ground_truth, 'b', 16.0);
  const MapQuality right = map_quality(made, merged, made.ground_truth, {}, {}, pool);
  const MapQuality wrong = map_quality(made, made.ground_truth, merged, {}, {}, pool);
  REQUIRE(right.near_between_robots.pairs > 10);
  REQUIRE(wrong.near_between_robots.pairs > 10);
  CHECK(2 * right.near_between_robots.proven > right.near_between_robots.pairs);
  CHECK(right.near_between_robots.median_m < 0.15);
  CHECK((wrong.near_between_robots.proven == 0 || wrong.near_between_robots.median_m > 5.0));
  CHECK(wrong.after.mean_m > 5.0);
  // Each robot's own revisits are those of the recording too, and do not count.
  CHECK(wrong.near.pairs == wrong.near_between_robots.pairs);
}

TEST_CASE("revisits: robots in right frames do not hide one in a wrong frame", "[evaluation][map]") {
  const Mission made = yard({'a', 'b', 'c'});
  const PosesByKey merged = with_moved_robot(made.ground_truth, 'c', 16.0);
  const auto is_of_moved = [](const auto& pair) {
    return (key_character(pair.first) == 'c') != (key_character(pair.second) == 'c');
  };
  const Revisits all = find_revisits(made, merged);
  REQUIRE(2 * std::count_if(all.begin(), all.end(), is_of_moved) < static_cast<int>(all.size()));
  const Revisits alone = find_new_revisits(made, merged, {}, made.ground_truth, map_quality_options());
  REQUIRE(alone.size() > 10);
  CHECK(std::all_of(alone.begin(), alone.end(), is_of_moved));
  CHECK(find_new_revisits(made, merged, {}, merged, map_quality_options()).empty());
}

TEST_CASE("map quality: without revisits there are no figures", "[evaluation][map]") {
  Mission made = yard();
  ThreadPool pool(1);
  PosesByKey apart = made.ground_truth;
  for (auto& [key, pose] : apart)
    pose.translation().x() += 50.0 * static_cast<double>(key_index(key) + 100 * (key >= make_key('b', 0)));
  const MapQuality none = map_quality(made, apart, apart, {}, {}, pool);
  CHECK(none.pairs == 0);
  CHECK(none.revisits.empty());
  CHECK(!none.enough());
  CHECK(std::isnan(none.after.mean_m));
  CHECK(std::isnan(none.share_registered));
  CHECK(std::isnan(none.thickness_after.mean_m));
  CHECK(none.coverage == 0.0);
  CHECK_THAT(none.not_meaningful(), Contains("of 0 pairs") && Contains("no registration proves one"));
  const Json json = parse_json(map_quality_json(none), "map quality");
  CHECK(json["not_meaningful"] == none.not_meaningful());
  CHECK(json["displacement_m"]["estimate"]["mean"].is_null());
  CHECK(json["thickness_m"]["estimate"].is_null());
}

/// A wall and a floor, and the noise of the scanner.
PointCloud wall_and_floor(Rng& rng) {
  PointCloud cloud;
  for (int i = 0; i < 4000; ++i) {
    Eigen::Vector3d p(rng.uniform(-6.0, 6.0), rng.uniform(-6.0, 3.3), rng.uniform(-0.8, 2.5));
    p[i % 2 == 0 ? 1 : 2] = i % 2 == 0 ? 3.3 : -0.8;
    p += 0.01 * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
    cloud.points.push_back(p.cast<float>());
  }
  return cloud;
}

TEST_CASE("plane thickness: a doubled wall is half as thick as its sheets are apart", "[evaluation][map]") {
  Rng rng(5);
  const PointCloud from = wall_and_floor(rng);
  PointCloud to = wall_and_floor(rng);
  const Eigen::Isometry3d T = se3::exp((Vector6d() << 0.7, -0.4, 0.2, 0.03, -0.05, 0.8).finished());
  for (Eigen::Vector3f& p : to.points) p = (T.inverse() * p.cast<double>()).cast<float>();
  const std::vector<SharedPlane> planes = shared_planes(from, to, T);
  REQUIRE(planes.size() > 100);
  std::size_t walls = 0;
  for (const SharedPlane& plane : planes) {
    // A cell at the edge between both has points of both.
    if (plane.from.mean.y() > 3.0 && plane.from.mean.z() < 0.0) continue;
    // 1 cm of noise, estimated from 8 points and more.
    CHECK(plane.thickness_m(T) < 0.02);
    const bool is_wall = std::abs(plane.normal.y()) > 0.9;
    walls += is_wall ? 1 : 0;
    for (const double apart_m : {0.1, 0.5, 3.0}) {  // also farther than a cell is wide
      const Eigen::Isometry3d moved = Eigen::Translation3d(0.0, apart_m, 0.0) * T;
      // Along the floor nothing shows. Normals of cells with few points are inclined, by less than 0.1.
      const double expected_m = is_wall ? 0.5 * apart_m : 0.0;
      CHECK(plane.thickness_m(moved) == Approx(expected_m).margin(0.015 + 0.1 * apart_m));
    }
  }
  CHECK(walls > 20);

  CHECK(shared_planes(PointCloud{}, to, T).empty());
  PointCloud broken = from;
  for (Eigen::Vector3f& p : broken.points) p.x() = std::numeric_limits<float>::quiet_NaN();
  CHECK(shared_planes(broken, to, T).empty());
}

TEST_CASE("revisits: their share of the path counts stretches with an end of one", "[evaluation][surfaces]") {
  const Mission made = yard();  // two robots, 46 m: three stretches of 20 m each
  CHECK(revisited_share(made, made.ground_truth, {}) == 0.0);
  const Revisits one = {{make_key('a', 23), make_key('a', 0)}};
  CHECK(revisited_share(made, made.ground_truth, one) == Approx(2.0 / 6.0));
  CHECK(revisited_share(made, made.ground_truth, {one[0], one[0]}) == Approx(2.0 / 6.0));
  CHECK(std::isnan(revisited_share(made, {}, {})));
  CHECK_THROWS_AS(revisited_share(made, made.ground_truth, one, 0.0), OptionError);
}

TEST_CASE("map quality: the summary of a run keeps it", "[evaluation][map]") {
  const testing::TemporaryFolder folder;
  testing::write_text(folder / "summary.json", R"({"mission": "m", "map_quality": 7, "seed": 1})");
  MapQuality quality;
  quality.pairs = 9;
  keep_map_quality(folder.path(), quality);
  const Json summary = read_json_file(folder / "summary.json");
  CHECK(summary["map_quality"]["pairs"] == 9);
  CHECK(summary["map_quality"]["not_meaningful"].is_string());
  CHECK(summary["mission"] == "m");
  CHECK(summary["seed"] == 1);
  testing::write_text(folder / "summary.json", "[]");
  CHECK_THROWS_AS(keep_map_quality(folder.path(), quality), InputError);
}

TEST_CASE("revisits: with drift nodes may be further apart the longer the path between them",
          "[evaluation][surfaces]") {
  const Mission made = yard();
  SurfaceAgreementOptions options;
  const std::size_t narrow = find_revisits(made, made.ground_truth, options).size();
  options.drift = 0.1;
  const Revisits wide = find_revisits(made, made.ground_truth, options);
  CHECK(wide.size() > narrow);
  options.reach_most_m = 1.0;  // never narrower than reach_m
  CHECK(find_revisits(made, made.ground_truth, options).size() == narrow);
}

}  // namespace
}  // namespace loopwise::map_quality_test
