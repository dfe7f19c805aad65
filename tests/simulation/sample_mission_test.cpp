// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <array>
#include <iterator>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/io/json_options.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "testing.hpp"

namespace loopwise::sample_mission_test {

namespace {

std::vector<std::array<float, 3>> sorted_points(const PointCloud& cloud) {
  std::vector<std::array<float, 3>> points;
  for (const Eigen::Vector3f& p : cloud.points) points.push_back({p.x(), p.y(), p.z()});
  std::sort(points.begin(), points.end());
  return points;
}

}  // namespace

TEST_CASE("sample mission: its provenance reproduces it", "[simulation][golden]") {
  const Mission sample = read_mission(testing::fs::path(LOOPWISE_SOURCE_DIR) / "data" / "sample_mission");
  REQUIRE(sample.problems.empty());
  const Json provenance = parse_json(sample.provenance_json, "provenance");
  REQUIRE(provenance.at("parameters_sha256") == std::string(simulation_parameters_hash()));
  SimulationOptions options;
  apply_json(provenance.at("options"), "options", options);
  const SimulatedMission made = simulate(options, std::stoull(provenance.at("seed").get<std::string>()));
  const Mission& again = made.mission;

  REQUIRE(sample.robots.size() == 2);
  REQUIRE(sample.graph.nodes().size() >= 50);
  REQUIRE(sample.graph.nodes().size() <= 70);
  REQUIRE_FALSE(sample.gaps.empty());
  REQUIRE_FALSE(sample.beacons.empty());
  REQUIRE(sample.graph.keys() == again.graph.keys());
  REQUIRE(sample.graph.edges().size() == again.graph.edges().size());
  REQUIRE(sample.gaps.size() == again.gaps.size());
  REQUIRE(sample.radio.size() == again.radio.size());
  REQUIRE(sample.beacons.size() == again.beacons.size());

  // On the processor that made it nothing differs: poses by 2e-16, points not at all. On others a rounding of
  // a sine or a ray on an edge may.
  std::size_t points = 0, different = 0;
  for (const Node& node : sample.graph.nodes()) {
    REQUIRE(testing::difference(node.pose, again.graph.node(node.key).pose) < 1e-6);
    REQUIRE(testing::difference(sample.ground_truth.at(node.key), again.ground_truth.at(node.key)) < 1e-6);
    REQUIRE(node.stamp_ns == again.graph.node(node.key).stamp_ns);
    const auto a = sorted_points(*sample.scans->load(node.key)),
               b = sorted_points(*again.scans->load(node.key));
    std::vector<std::array<float, 3>> only;
    std::set_symmetric_difference(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(only));
    points += a.size();
    different += (only.size() + 1) / 2;
  }
  CAPTURE(points, different);
  REQUIRE(static_cast<double>(different) <= 0.001 * static_cast<double>(points));
}

}  // namespace loopwise::sample_mission_test
