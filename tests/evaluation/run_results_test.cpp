// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <set>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_picture.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::run_results_test {
namespace {

// It keeps a reference to its mission.
static_assert(std::is_constructible_v<RunHistory, Mission&>);
static_assert(!std::is_constructible_v<RunHistory, Mission>);

ReplayResult replayed(const Mission& mission, const ReplayOptions& config, RunHistory* history = nullptr) {
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
  std::map<Key, Eigen::Isometry3d> truth = mission.ground_truth;
  if (truth.empty()) truth = testing::two_circles().ground_truth;
  const auto registrar = std::make_shared<testing::OracleRegistrar>(truth);
  ThreadPool pool(1);
  ReplayHooks hooks;
  if (history) hooks.moment = [history](const ReplayMoment& moment) { history->add(moment); };
  return MissionReplay(mission, config, {features, registrar}).run(pool, hooks);
}

ReplayOptions short_config() {
  ReplayOptions config;
  config.prioritization.method = parse_method("random");
  config.max_registrations = 60;
  return config;
}

std::size_t occurrences(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++count;
  return count;
}

}  // namespace

TEST_CASE("run folder: contains the run, and its files are consistent", "[evaluation][run]") {
  const Mission mission = testing::two_circles();
  const ReplayOptions config = short_config();
  RunHistory history(mission);
  const ReplayResult result = replayed(mission, config, &history);
  const RunEvaluation evaluation = evaluate_run(mission, result);
  const testing::TemporaryFolder folder;
  write_run_folder(folder.path(), mission, config, result, evaluation, history.rows(),
                   stitch_map(result.graph, *mission.scans, 0.2).cloud);

  const Json summary = parse_json(testing::read_text(folder / "summary.json"), "summary.json");
  const Json& candidates = summary.at("candidates");
  const auto count = [](const Json& json, const char* name) { return json.at(name).get<std::size_t>(); };
  REQUIRE(count(candidates, "computed") == 60);
  REQUIRE(count(candidates, "queued") == count(candidates, "generated") - count(candidates, "pruned"));
  std::size_t rejected = 0;
  for (const auto& [reason, number] : summary.at("reasons").items()) rejected += number.get<std::size_t>();
  REQUIRE(count(summary.at("closures"), "verified") + rejected == 60);
  REQUIRE(summary.at("ate_m").at("optimized").get<double>() == evaluation.optimized.ate_m.mean);
  REQUIRE(summary.at("ate_m").at("odometry").get<double>() == evaluation.odometry.ate_m.mean);
  for (const char* field : {"ate_se3_m", "ate_rmse_m", "rpe", "robots", "seconds", "seed", "options"}) {
    REQUIRE(summary.contains(field));
  }

  // The rows agree with the counts of the summary.
  const CsvTable rows(folder / "closures.csv",
                      {"from", "to", "source", "outcome", "reason", "x", "y", "z", "qx", "qy", "qz", "qw",
                       "fitness", "overlap", "weight", "mission_time_s", "seconds"});
  REQUIRE(rows.size() == 60);
  std::size_t verified = 0, inliers = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const bool passed = rows.text(i, 3) == "verified";
    REQUIRE(rows.text(i, 4).empty() == passed);
    verified += passed ? 1 : 0;
    inliers += passed && rows.number(i, 14) > 0.5 ? 1 : 0;
    if (!passed) continue;
    REQUIRE(rows.key(i, 0) == result.computed[i].result.candidate.from);
    REQUIRE(rows.number(i, 5) == result.computed[i].result.closure->T_from_to.translation().x());
  }
  REQUIRE(verified == count(summary.at("closures"), "verified"));
  REQUIRE(inliers == count(summary.at("closures"), "gnc_inliers"));
  REQUIRE(inliers > 0);

  REQUIRE(read_g2o(folder / "graph.g2o").graph.nodes().size() == 80);
  for (const char* name : {"a.tum", "a_odometry.tum", "b.tum", "b_odometry.tum"}) {
    REQUIRE(read_tum(folder / "trajectories" / name).size() == 40);
  }
  REQUIRE(read_tum(folder / "trajectories" / "b.tum")[0].stamp_ns == 500000000);
  REQUIRE(read_cloud(folder / "map.pcd").cloud.size() > 1000);
  REQUIRE(testing::fs::exists(folder / "picture.svg"));
}

TEST_CASE("run results: a reference is no truth, residuals need no truth", "[evaluation][run]") {
  // As a session whose own optimised poses are worse than its odometry.
  Mission mission = testing::two_circles();
  mission.reference = std::exchange(mission.ground_truth, {});
  for (auto& [key, pose] : mission.reference)
    pose.translation().z() += 0.2 * static_cast<double>(key_index(key));
  RunHistory history(mission);
  const ReplayResult result = replayed(mission, short_config(), &history);
  const RunEvaluation e = evaluate_run(mission, result);
  REQUIRE_FALSE(e.has_truth);
  REQUIRE(e.closures.true_inliers == 0);
  REQUIRE(e.has_reference);
  REQUIRE(e.optimized_reference.ate_m.mean > 3.0);
  for (const HistoryRow& row : history.rows()) REQUIRE((std::isnan(row.ate_m) && row.true_inliers == 0));
  // The residuals of kept closures are their noise, 0.02 m per coordinate; odometry has drifted.
  REQUIRE(e.residuals.translation_m.count == e.closures.gnc_inliers);
  REQUIRE(e.residuals.translation_m.median < 0.1);
  REQUIRE(e.odometry_residuals.translation_m.median > 3.0 * e.residuals.translation_m.median);

  const Json summary = parse_json(run_summary_json(mission, short_config(), result, e), "summary");
  for (const char* name : {"truth", "ate_m", "ate_rad", "ate_se3_m", "ate_rmse_m", "rpe"}) {
    CAPTURE(name);
    REQUIRE(summary.at(name).is_null());
  }
  REQUIRE(summary.at("closures").at("true_inliers").is_null());
  REQUIRE(summary.at("reference").at("poses") == 80);
  REQUIRE(summary.at("reference").at("difference_m").at("optimized").get<double>() ==
          e.optimized_reference.ate_m.mean);
  REQUIRE(summary.at("residuals").at("optimized").at("translation_m").at("median").get<double>() ==
          e.residuals.translation_m.median);
  const std::string picture = run_picture_svg(mission, result, {});
  REQUIRE(picture.find("truth") == std::string::npos);
  REQUIRE(picture.find("optimised by another program") != std::string::npos);
}

TEST_CASE("run folder: a map far from zero keeps its points", "[evaluation][run]") {
  const Eigen::Vector3d offset(432100.25, 5432109.75, 30.5);
  Mission near = testing::two_circles();
  ReplayResult result;
  result.graph = near.graph;
  result.odometry = near.graph.poses();
  const StitchedMap map = stitch_map(result.graph, *near.scans, 0.2);
  const std::string svg = run_picture_svg(near, result, map.cloud);
  REQUIRE(map.cloud.origin.isZero(0.0));

  Mission far = near;
  std::vector<Eigen::Isometry3d> poses = near.graph.poses();
  for (Eigen::Isometry3d& pose : poses) pose.pretranslate(offset);
  for (auto& [key, pose] : far.ground_truth) pose.pretranslate(offset);
  result.graph.set_poses(poses);
  result.odometry = poses;
  const StitchedMap moved = stitch_map(result.graph, *far.scans, 0.2);
  REQUIRE((moved.cloud.origin - offset).norm() < 50.0);
  REQUIRE(moved.cloud.origin == map_origin(result.graph));
  // The voxels lie elsewhere: measured 0.2 % fewer points; in floats about zero there were a third fewer.
  const auto ratio = static_cast<double>(moved.cloud.size()) / static_cast<double>(map.cloud.size());
  REQUIRE(std::abs(ratio - 1.0) < 0.03);
  const std::string moved_svg = run_picture_svg(far, result, moved.cloud);
  REQUIRE(std::abs(static_cast<double>(occurrences(moved_svg, "h0")) /
                       static_cast<double>(occurrences(svg, "h0")) -
                   1.0) < 0.1);

  const testing::TemporaryFolder folder;
  write_run_folder(folder.path(), far, short_config(), result, evaluate_run(far, result), {}, moved.cloud);
  const Json summary = parse_json(testing::read_text(folder / "summary.json"), "summary.json");
  for (std::size_t axis = 0; axis < 3; ++axis) {
    REQUIRE(summary.at("map_origin_m").at(axis) == moved.cloud.origin[static_cast<Eigen::Index>(axis)]);
  }
  REQUIRE_THAT(testing::read_text(folder / "map.pcd"), Contains("# loopwise origin "));
  REQUIRE(read_cloud(folder / "map.pcd").cloud.origin == moved.cloud.origin);
}

TEST_CASE("run folder: the map leaves out strays", "[evaluation][run]") {
  PoseGraph graph;
  graph.add_node({});
  const auto cloud = std::make_shared<PointCloud>();
  cloud->points = {{1, 2, 3}, {2, 3, 4}, {9e6F, 0, 0}};
  const ScanStore scans({0}, [&](Key) -> std::shared_ptr<const PointCloud> { return cloud; });
  const StitchedMap map = stitch_map(graph, scans, 0.2);
  REQUIRE(map.cloud.size() == 2);
  REQUIRE(map.problems.count("point too far from the sensor left out") == 1);
  REQUIRE(stitch_map(graph, scans, 0.2, {}, {}, 0.0).cloud.size() == 3);
}

TEST_CASE("run results: robots with names that give the same file name get separate files",
          "[evaluation][run]") {
  const testing::TemporaryFolder folder;
  Mission mission = testing::two_circles();
  mission.robots = Robots({robot_of_character('a', "spot/1"), robot_of_character('b', "spot 1")});
  ReplayResult result;
  result.graph = mission.graph;
  result.odometry = mission.graph.poses();
  write_run_folder(folder.path(), mission, ReplayOptions(), result, evaluate_run(mission, result), {}, {});
  std::size_t files = 0;
  for (const auto& entry : testing::fs::directory_iterator(folder / "trajectories")) {
    REQUIRE(read_tum(entry.path()).size() == 40);
    ++files;
  }
  REQUIRE(files == 4);
}

TEST_CASE("run history: counts never fall, the rows are dense, the last one is the result",
          "[evaluation][run]") {
  const Mission mission = testing::two_circles();
  const std::string method = GENERATE("odom", "random");
  ReplayOptions config = short_config();
  config.prioritization.method = parse_method(method);
  config.batch = 10;
  RunHistory history(mission);
  const ReplayResult result = replayed(mission, config, &history);
  const RunEvaluation evaluation = evaluate_run(mission, result);
  const std::vector<HistoryRow>& rows = history.rows();

  REQUIRE(rows.size() >= (method == "odom" ? 8 : 12));  // 78.5 s; six batches besides
  for (std::size_t i = 1; i < rows.size(); ++i) {
    REQUIRE(rows[i].mission_time_s > rows[i - 1].mission_time_s);
    REQUIRE(rows[i].mission_time_s - rows[i - 1].mission_time_s <
            12.0);  // key frames come every 1.5 s at most
    REQUIRE(rows[i].key_frames >= rows[i - 1].key_frames);
    REQUIRE(rows[i].computed >= rows[i - 1].computed);
    REQUIRE(rows[i].true_inliers <= rows[i].verified);
    REQUIRE(rows[i].right_inliers <= std::min(rows[i].true_inliers, rows[i].gnc_inliers));
  }
  const HistoryRow& last = rows.back();
  REQUIRE(last.mission_time_s == result.mission_time_s);
  REQUIRE(result.mission_end_s == 78.5);
  REQUIRE(last.queued == result.accounting.queued());
  REQUIRE(last.computed == result.computed.size());
  REQUIRE(last.verified == evaluation.closures.verified);
  REQUIRE(last.gnc_inliers == evaluation.closures.gnc_inliers);
  REQUIRE(last.true_inliers == evaluation.closures.true_inliers);
  REQUIRE(last.right_inliers == evaluation.closures.right_inliers);
  REQUIRE(last.ate_m == Approx(evaluation.optimized.ate_m.mean).epsilon(1e-12));
  REQUIRE(last.odometry_ate_m == Approx(evaluation.odometry.ate_m.mean).epsilon(1e-12));

  const testing::TemporaryFolder folder;
  testing::write_text(folder / "history.csv", history_csv(rows));
  const CsvTable table(folder / "history.csv",
                       {"mission_time_s", "key_frames", "generated", "queued", "computed", "verified",
                        "gnc_inliers", "true_inliers", "right_inliers", "ate_m", "odometry_ate_m"});
  REQUIRE(table.size() == rows.size());
  REQUIRE(table.number(rows.size() - 1, 9) == last.ate_m);
}

TEST_CASE("run folder: without ground truth errors are null, not zero", "[evaluation][run]") {
  Mission mission = testing::two_circles();
  mission.ground_truth.clear();
  const ReplayOptions config = short_config();
  const ReplayResult result = replayed(mission, config);
  const RunEvaluation evaluation = evaluate_run(mission, result);
  REQUIRE_FALSE(evaluation.has_truth);
  const Json summary = parse_json(run_summary_json(mission, config, result, evaluation), "summary");
  REQUIRE(summary.at("ate_m").is_null());
  REQUIRE(summary.at("closures").at("true_inliers").is_null());
  REQUIRE(summary.at("closures").at("verified").get<std::size_t>() > 0);
}

TEST_CASE("run picture: paths, truth and closures", "[evaluation][picture]") {
  Mission mission = testing::two_circles();
  mission.robots = Robots({robot_of_character('a', "a & <b>"), robot_of_character('b', "b")});
  const ReplayResult result = replayed(mission, short_config());
  const PointCloud map = stitch_map(result.graph, *mission.scans, 0.2).cloud;
  const std::string svg = run_picture_svg(mission, result, map);
  const ClosureStatistics closures = evaluate_run(mission, result).closures;

  REQUIRE(occurrences(svg, "<polyline") == 6);  // two robots: optimised, odometry, truth
  REQUIRE(occurrences(svg, "stroke=\"#35a35f\" stroke-width=\"1\"") == closures.gnc_inliers);
  REQUIRE(occurrences(svg, "stroke=\"#d1342f\" stroke-width=\"1\"") ==
          closures.verified - closures.gnc_inliers);
  REQUIRE(occurrences(svg, "h0") > 500);  // points of the map
  REQUIRE(Contains(">a &amp; &lt;b&gt;</text>").match(svg));
  REQUIRE(occurrences(svg, "nan") + occurrences(svg, "inf") == 0);
  REQUIRE(run_picture_svg(mission, result, map) == svg);

  mission.ground_truth.clear();
  REQUIRE(occurrences(run_picture_svg(mission, result, {}), "<polyline") == 4);
  REQUIRE(Contains("</svg>").match(run_picture_svg(Mission(), ReplayResult(), {})));
}

}  // namespace loopwise::run_results_test
