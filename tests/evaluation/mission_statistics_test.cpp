// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <loopwise/evaluation/mission_picture.hpp>
#include <loopwise/evaluation/mission_statistics.hpp>

#include "testing.hpp"

namespace loopwise::mission_statistics_test {

namespace {

/// Two robots that drive the same 40 m; the second's odometry turns by 0.01 rad a step.
Mission two_robots() {
  Mission mission;
  mission.robots = Robots({robot_of_character('a', "a"), robot_of_character('b', "b")});
  for (const char robot : {'a', 'b'}) {
    Eigen::Isometry3d truth = Eigen::Isometry3d::Identity(), estimate = truth;
    for (std::uint64_t k = 0; k <= 20; ++k) {
      Node node;
      node.key = make_key(robot, k);
      node.pose = estimate;
      node.stamp_ns = static_cast<std::int64_t>(k) * 2'000'000'000 + (robot == 'b' ? 1 : 0);
      mission.graph.add_node(node);
      mission.ground_truth[node.key] = truth;
      Eigen::Isometry3d step = Eigen::Isometry3d::Identity();
      step.translation().x() = 2.0;
      truth = truth * step;
      if (robot == 'b') step.linear() = se3::so3_exp({0.0, 0.0, 0.01});
      estimate = estimate * step;
    }
  }
  return mission;
}

}  // namespace

TEST_CASE("odometry drift: a constant turn", "[evaluation]") {
  const auto drift = odometry_drift(two_robots());
  REQUIRE(drift.size() == 2);
  REQUIRE(drift[0].length_m == Approx(40.0));
  REQUIRE(drift[0].largest_m == Approx(0.0).margin(1e-9));
  REQUIRE(drift[1].largest_rad == Approx(0.2));
  // Sum of 2·(cos 0.01k − 1, sin 0.01k) over 20 steps.
  double x = -40.0, y = 0.0;
  for (int k = 0; k < 20; ++k) {
    x += 2.0 * std::cos(0.01 * k);
    y += 2.0 * std::sin(0.01 * k);
  }
  REQUIRE(drift[1].end_m == Approx(std::hypot(x, y)));
  REQUIRE(drift[1].largest_m == Approx(drift[1].end_m));
}

TEST_CASE("candidate statistics: counts equal those of brute force, overlap of equal and of far scans",
          "[evaluation]") {
  Mission mission = two_robots();
  std::size_t expected = 0;
  const auto& nodes = mission.graph.nodes();
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const bool near = (nodes[i].pose.translation() - nodes[j].pose.translation()).norm() <= 10.0;
      const bool same = key_character(nodes[i].key) == key_character(nodes[j].key);
      const auto a = key_index(nodes[i].key), b = key_index(nodes[j].key);
      if (near && !(same && (a > b ? a - b : b - a) < 4)) ++expected;
    }
  }
  CandidateStatisticsOptions options;
  options.radius_m = 10.0;
  options.skip_recent = 4;
  REQUIRE(candidate_statistics(mission, options).candidates == expected);
  REQUIRE(candidate_statistics(mission, options).looked_at == 0);  // no scans

  // Every scan sees the same wall of points at y = 1 m, x in [0, 30] of the world: neighbours share most of
  // them.
  PointCloud wall;
  for (int i = 0; i <= 300; ++i) wall.points.emplace_back(0.1F * static_cast<float>(i), 1.0F, 0.0F);
  const auto truth = mission.ground_truth;
  mission.scans = std::make_shared<ScanStore>(
      mission.graph.keys(),
      [wall, truth](Key key) -> std::shared_ptr<const PointCloud> {
        PointCloud seen;
        const Eigen::Isometry3f T = truth.at(key).inverse().cast<float>();
        for (const auto& p : wall.points) seen.points.push_back(T * p);
        return std::make_shared<const PointCloud>(seen);
      },
      0);
  const CandidateStatistics all = candidate_statistics(mission, options);
  REQUIRE(all.looked_at == expected);
  REQUIRE(all.mean_overlap == Approx(1.0));
  REQUIRE(all.overlapping == Approx(1.0));

  options.radius_m = -1.0;
  REQUIRE_THROWS_AS(candidate_statistics(mission, options), OptionError);
}

TEST_CASE("mission picture: names robots and beacons, escapes names, survives an empty mission",
          "[evaluation]") {
  Mission mission = two_robots();
  mission.name = "<mine> & \"more\"";
  mission.beacons.push_back({"b<7>", 1, make_key('b', 4), 0});
  mission.gaps.push_back({0, 3.0, 9.0});
  const std::string picture = mission_picture_svg(mission);
  for (const Robot& robot : mission.robots.all())
    REQUIRE_THAT(picture, Contains(">" + robot.name + "</text>"));
  REQUIRE_THAT(picture, Contains("b&lt;7&gt;") && Contains("&lt;mine&gt; &amp;") && !Contains("<mine>"));
  REQUIRE_THAT(picture, Contains("#bbbbbb"));  // three nodes out of range
  REQUIRE_THAT(mission_picture_svg(Mission{}), Contains("</svg>") && !Contains("nan") && !Contains("inf"));
}

}  // namespace loopwise::mission_statistics_test
