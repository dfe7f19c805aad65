// SPDX-License-Identifier: BSD-3-Clause
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/report.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/json_options.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::report_review_test {
namespace {

/// A run of the two circles as its folder, with one closure in five left out and moved.
ReplayResult write_run(const Mission& mission, const testing::fs::path& folder) {
  ReplayOptions options;
  options.prioritization.method = parse_method("random");
  options.max_registrations = 60;
  const auto features =
      std::make_shared<FeatureCache>(mission.scans->loader(), options.registration.features);
  const auto registrar = std::make_shared<testing::OracleRegistrar>(mission.ground_truth);
  ThreadPool pool(1);
  ReplayResult result = MissionReplay(mission, options, {features, registrar}).run(pool);
  std::size_t verified = 0;
  for (ComputedCandidate& computed : result.computed) {
    if (!computed.result.verified()) continue;
    if (verified++ % 5 != 0) continue;
    computed.weight = 0.0;
    computed.result.closure->T_from_to.translation().x() += 1.0;
  }
  write_run_folder(folder, mission, options, result, evaluate_run(mission, result), {}, PointCloud());
  return result;
}

Json scene_of(const testing::fs::path& folder, const std::vector<Mission>& missions,
              const ReportOptions& options = {}) {
  ThreadPool threads(1);
  const Json data = parse_json(make_report({folder}, missions, options, threads).data, "data");
  return data.at("runs").at(0).at("scene");
}

Eigen::Isometry3d pose_of(const Json& matrix) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (int k = 0; k < 12; ++k)
    T.matrix()(k / 4, k % 4) = matrix.at(static_cast<std::size_t>(k)).get<double>();
  return T;
}

}  // namespace

TEST_CASE("report: closures to review, those left out first, then the ones that the estimate moves most",
          "[evaluation][report]") {
  const Mission mission = testing::two_circles();
  const testing::TemporaryFolder folder;
  const ReplayResult result = write_run(mission, folder.path());
  const Json scene = scene_of(folder.path(), {mission});
  const Json& review = scene.at("review");
  std::size_t verified = 0;
  for (const ComputedCandidate& computed : result.computed) verified += computed.result.verified() ? 1 : 0;
  REQUIRE(review.at("total") == verified);
  REQUIRE(review.at("closures").size() == std::min<std::size_t>(verified, 60));

  bool kept_before = false;
  double last_m = 1e9;
  std::set<std::string> nodes;
  for (const Json& closure : review.at("closures")) {
    const bool kept = closure.at("weight").get<double>() > 0.5;
    REQUIRE((kept || !kept_before));
    if (kept != kept_before) last_m = 1e9;
    kept_before = kept;
    const double off = closure.at("off_m").get<double>() +
                       10.0 * closure.at("off_deg").get<double>() * 3.14159265358979 / 180.0;
    REQUIRE(off <= last_m + 1e-9);
    last_m = off;

    const Key from = parse_key(closure.at("keys").at(0).get<std::string>());
    const Key to = parse_key(closure.at("keys").at(1).get<std::string>());
    const auto of_node = [&](Key key) {
      const PoseGraph& graph = result.graph;
      return graph.node(key).pose;
    };
    REQUIRE(pose_of(closure.at("estimate")).isApprox(of_node(from).inverse() * of_node(to), 1e-5));
    REQUIRE((pose_of(closure.at("registration")).inverse() * pose_of(closure.at("estimate")))
                .translation()
                .norm() == Approx(closure.at("off_m").get<double>()).margin(1e-9));
    REQUIRE(closure.at("odometry").size() == 12);
    for (const char* end : {"from", "to"}) nodes.insert(std::to_string(closure.at(end).get<std::size_t>()));
  }
  REQUIRE(kept_before);
  REQUIRE(review.at("closures").at(0).at("weight") == 0.0);
  REQUIRE(review.at("scans").size() == nodes.size());
  for (const std::string& node : nodes) REQUIRE(review.at("scans").contains(node));

  ReportOptions three;
  three.review_closures = 3;
  REQUIRE(scene_of(folder.path(), {mission}, three).at("review").at("closures").size() == 3);
  three.review_closures = 0;
  REQUIRE(scene_of(folder.path(), {mission}, three).at("review").is_null());
  REQUIRE(scene_of(folder.path(), {}).at("review").is_null());  // no scans without the mission
}

}  // namespace loopwise::report_review_test
