// SPDX-License-Identifier: BSD-3-Clause
// Figures of missions, runs, trajectories and maps as JSON and as text.
#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/map_quality.hpp>
#include <loopwise/evaluation/mission_summary.hpp>
#include <loopwise/evaluation/run_text.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/evaluation/trajectory_source.hpp>
#include <loopwise/evaluation/trajectory_text.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::summary_texts_test {
namespace {

using testing::TemporaryFolder;
using testing::two_circles;
using testing::write_text;

/// A run in which all registrations failed in one way.
struct FailedRun {
  ReplayResult result;
  RunEvaluation evaluation;

  FailedRun() {
    result.accounting.generated = 30;
    result.accounting.computed = 20;
    result.accounting.pending = 10;
    evaluation.closures.rejected[RejectionReason::kLowOverlap] = 15;
    evaluation.closures.rejected[RejectionReason::kAmbiguous] = 5;
  }
  [[nodiscard]] std::string text(const ReplayOptions& options = {}, const RunTextOptions& about = {}) const {
    return run_results_text(parse_robots("a"), options, result, evaluation, about);
  }
};

}  // namespace

TEST_CASE("text tables: a count has its noun", "[evaluation][text]") {
  REQUIRE(counted(1, "closure") == "1 closure");
  REQUIRE(counted(0, "closure") == "0 closures");
  REQUIRE(counted(2, "study", "studies") == "2 studies");
  REQUIRE(counted(1, "study", "studies") == "1 study");
}

TEST_CASE("mission summary: counts, lengths and keys", "[evaluation][mission]") {
  Mission mission = two_circles();
  Mission landmarked = mission;
  std::vector<Robot> robots = mission.robots.all();
  robots.push_back(robot_of_character('L', "signs"));
  robots.back().landmarks = true;
  std::sort(robots.begin(), robots.end(), [](const Robot& a, const Robot& b) { return a.first < b.first; });
  landmarked.robots = Robots(robots);
  Node sign;
  sign.key = make_key('L', 0);
  sign.stamp_ns = -1000000000000;
  landmarked.graph.add_node(sign);
  Edge sighting;
  sighting.from = make_key('a', 0);
  sighting.to = sign.key;
  sighting.kind = EdgeKind::kLandmark;
  landmarked.graph.add_edge(sighting);

  const MissionSummary s = summarize_mission(mission);
  REQUIRE(s.nodes == 80);
  REQUIRE(s.edges == 78);
  REQUIRE(s.odometry_edges == 78);
  REQUIRE(s.priors == 2);
  REQUIRE(s.components == 2);
  REQUIRE(s.ground_truth == 80);
  REQUIRE(s.duration_s == Approx(78.5));
  REQUIRE(s.robots.size() == 2);
  REQUIRE(s.robots[0].nodes == 40);
  REQUIRE(s.robots[1].first_key == make_key('b', 0));
  REQUIRE(s.robots[1].last_key == make_key('b', 39));
  double length = 0.0;
  for (std::uint64_t i = 1; i < 40; ++i) {
    length += (mission.graph.node(make_key('a', i)).pose.translation() -
               mission.graph.node(make_key('a', i - 1)).pose.translation())
                  .norm();
  }
  REQUIRE(s.robots[0].length_m == Approx(length).epsilon(1e-12));
  REQUIRE(s.length_m == Approx(s.robots[0].length_m + s.robots[1].length_m).epsilon(1e-12));

  // Landmarks have no path, and their stamps are not those of key frames.
  const MissionSummary with_sign = summarize_mission(landmarked);
  REQUIRE(with_sign.nodes == 81);
  REQUIRE(with_sign.sightings == 1);
  REQUIRE(with_sign.length_m == Approx(s.length_m).epsilon(1e-12));
  REQUIRE(with_sign.duration_s == s.duration_s);
  REQUIRE_THAT(mission_summary_text(with_sign), Contains("signs") && Contains("landmarks") &&
                                                    Contains("other        1 sightings of landmarks"));
}

TEST_CASE("mission summary: JSON and text have the same figures", "[evaluation][mission]") {
  Mission mission = two_circles();
  mission.reference = mission.ground_truth;
  mission.problems.add("flaw", "graph.g2o:3");
  const PointCounts points = count_points(*mission.scans);
  REQUIRE(points.scans == mission.scans->size());
  REQUIRE(points.fewest <= points.most);
  REQUIRE(points.mean() == Approx(static_cast<double>(points.total) / static_cast<double>(points.scans)));
  const MissionSummary s = summarize_mission(mission, points);
  const Json json = parse_json(mission_summary_json(s), "summary");
  REQUIRE(json.at("kind") == "mission");
  REQUIRE(json.at("nodes") == 80);
  REQUIRE(json.at("points").at("total") == points.total);
  REQUIRE(json.at("length_m").get<double>() == s.length_m);
  REQUIRE(json.at("robots").at(1).at("last_key") == std::to_string(make_key('b', 39)));
  REQUIRE(json.at("problems").size() == 1);
  const std::string text = mission_summary_text(s);
  REQUIRE_THAT(text,
               Contains("\"two circles\"\n") && Contains("80 nodes, 78 edges (78 odometry), 2 priors") &&
                   Contains(fixed(s.length_m, 1) + " m in 78.5 s") && Contains("reference    80 poses") &&
                   Contains(fixed(s.reference_difference_m.max, 2) + " m at most"));

  const MissionSummary empty = summarize_mission({});
  REQUIRE(empty.components == 0);
  REQUIRE(empty.duration_s == 0.0);
  REQUIRE_THAT(mission_summary_text(empty), Contains("0 nodes") && !Contains("reference"));
}

TEST_CASE("mission summary: scans that cannot be read are left out and counted", "[evaluation][mission]") {
  Mission mission = two_circles();
  const std::vector<Key> keys{make_key('a', 0), make_key('a', 1)};
  mission.scans = std::make_shared<ScanStore>(keys, [](Key key) -> std::shared_ptr<const PointCloud> {
    if (key == make_key('a', 1)) throw InputError("broken");
    auto cloud = std::make_shared<PointCloud>();
    cloud->points.resize(7);
    return cloud;
  });
  const PointCounts points = count_points(*mission.scans);
  REQUIRE(points.scans == 1);
  REQUIRE(points.total == 7);
  REQUIRE(points.fewest == 7);
  REQUIRE(summarize_mission(mission, points).problems.all().size() == 1);
}

TEST_CASE("run text: a run without closures has the reason and a remedy", "[evaluation][run]") {
  FailedRun run;
  REQUIRE_THAT(run.text(), Contains("no closure   of 20 registrations, 15 failed by low_overlap: the pairs "
                                    "have hardly any common surface") &&
                               Contains("rejected     5 ambiguous, 15 low_overlap") &&
                               Contains("20 computed, 10 pending"));
  run.evaluation.closures.verified = 1;
  REQUIRE_THAT(run.text(), !Contains("no closure"));
}

TEST_CASE("run text: candidates that are pending have the option that computes them", "[evaluation][run]") {
  FailedRun run;
  REQUIRE_THAT(run.text(),
               Contains("pending      10 not computed when the mission ended, by a modelled computer "
                        "of 10 workers and 1.3 s a registration: --after-mission"));
  REQUIRE_THAT(run.text({}, {0, false}), Contains("when the mission ended: --after-mission"));
  ReplayOptions bounded;
  bounded.max_registrations = 20;
  REQUIRE_THAT(run.text(bounded), Contains("pending      10 beyond --max-registrations"));
  ReplayOptions after;
  after.after_mission = true;
  REQUIRE_THAT(run.text(after), !Contains("pending      10"));
  run.result.interrupted = true;
  REQUIRE_THAT(run.text(bounded), !Contains("beyond"));
  FailedRun complete;
  complete.result.accounting.pending = 0;
  REQUIRE_THAT(complete.text(), Contains("order        all candidates were computed"));
}

TEST_CASE("run text: errors are printed only if they are meaningful", "[evaluation][run]") {
  FailedRun run;
  REQUIRE_FALSE(is_judged(run.evaluation));
  REQUIRE_THAT(run.text(), !Contains("ATE"));
  run.evaluation.has_truth = true;
  run.evaluation.odometry.ate_m = statistics({0.0, 0.0});
  REQUIRE_FALSE(is_judged(run.evaluation));
  REQUIRE_THAT(run.text(), Contains("ATE          not judged: odometry and truth are the same poses"));
  run.evaluation.odometry.ate_m = statistics({1.0, 2.0});
  run.evaluation.optimized.ate_m = statistics({0.25, 0.75});
  REQUIRE(is_judged(run.evaluation));
  REQUIRE_THAT(run.text(), Contains("ATE mean     1.500 m by odometry, 0.500 m optimised (aligned: "));
  run.evaluation.optimized.alignment = Alignment::kSe3;
  REQUIRE_THAT(run.text(), Contains("0.500 m optimised, aligned: the truth is in another frame"));
}

TEST_CASE("trajectory text: the figures of the errors, robot by robot", "[evaluation][trajectory]") {
  const Mission mission = two_circles();
  const TrajectoryErrors errors = evaluate_trajectory(poses_by_key(mission.graph), mission.ground_truth,
                                                      Alignment::kNone, mission.robots);
  const Json json = parse_json(trajectory_errors_json(errors), "errors");
  REQUIRE(json.at("poses") == 80);
  REQUIRE(json.at("alignment") == "none");
  REQUIRE(json.at("ate_m").at("mean").get<double>() == errors.ate_m.mean);
  REQUIRE(json.at("rpe_by_distance").size() == errors.by_distance.size());
  REQUIRE(json.at("rpe_by_distance").at(0).at("distance_m") == errors.by_distance[0].distance_m);
  REQUIRE(json.at("robots").at("b").at("ate_m").at("max").get<double>() == errors.robots[1].ate_m.max);
  const std::string text = trajectory_errors_table(errors);
  REQUIRE_THAT(text, Contains(fixed(errors.robots[0].ate_m.mean, 3)) && Contains("\nall "));
  REQUIRE(std::count(text.begin(), text.end(), '\n') == 5);  // header, rule, two robots, all
}

TEST_CASE("trajectory source: recordings, runs and files of poses", "[evaluation][trajectory]") {
  const TemporaryFolder folder;
  const Mission mission = two_circles();
  write_mission(folder / "mission", mission);
  const TrajectoryPair own = read_trajectory_pair(folder / "mission", folder / "mission");
  REQUIRE(own.estimate.poses.size() == 80);
  REQUIRE(own.truth.poses.size() == 80);
  REQUIRE(own.robots.size() == 2);
  REQUIRE_FALSE(own.odometry_is_truth);
  const PosePairs pairs = associate(own.estimate, own.truth);
  REQUIRE(pairs.keys.size() == 80);
  REQUIRE(testing::difference(pairs.truth[5], mission.ground_truth.at(pairs.keys[5])) < 1e-12);

  // A run's folder stands for its graph, paired by key.
  testing::fs::create_directories(folder / "run");
  write_text(folder / "run" / "summary.json", "{}");
  write_g2o(folder / "run" / "graph.g2o", mission.graph);
  const TrajectoryPair of_run = read_trajectory_pair(folder / "run", folder / "mission");
  REQUIRE(of_run.estimate.format == TrajectoryFormat::kG2o);
  REQUIRE(associate(of_run.estimate, of_run.truth).keys.size() == 80);

  // A recording is paired with a TUM file by stamp; its keys are row numbers, which no robot owns.
  std::vector<StampedPose> rows;
  for (const Node& node : mission.graph.nodes()) {
    if (key_character(node.key) == 'a') rows.push_back({node.stamp_ns, node.pose});
  }
  write_tum(folder / "a.tum", rows);
  const TrajectoryPair by_stamp = read_trajectory_pair(folder / "a.tum", folder / "mission");
  REQUIRE(by_stamp.truth.format == TrajectoryFormat::kTum);
  REQUIRE(by_stamp.robots.size() == 0);
  REQUIRE(associate(by_stamp.estimate, by_stamp.truth).keys.size() == 40);
}

TEST_CASE("trajectory source: truth that equals odometry, and no truth", "[evaluation][trajectory]") {
  const TemporaryFolder folder;
  Mission mission = two_circles();
  for (const Node& node : mission.graph.nodes()) mission.ground_truth[node.key] = node.pose;
  write_mission(folder / "same", mission);
  REQUIRE(read_trajectory_pair(folder / "same", folder / "same").odometry_is_truth);
  mission.ground_truth.clear();
  write_mission(folder / "none", mission);
  REQUIRE_THROWS_WITH(read_trajectory_pair(folder / "none", folder / "none"),
                      Contains("no ground truth is recorded there"));
}

TEST_CASE("map quality text: without revisits the reason, and warnings of wrong maps", "[evaluation][map]") {
  MapQuality q;
  q.pairs = 12;
  REQUIRE_THAT(map_quality_text(q), Contains("not meaningful: of 12 pairs"));
  REQUIRE(map_quality_warning(q).empty());
  q.near = {20, 18, 0.05};
  REQUIRE(map_quality_warning(q).empty());
  REQUIRE_THAT(map_quality_text(q), Contains("near         pairs") && Contains("18 of 20, 0.050 m off"));
  q.near = {20, 3, 0.05};
  REQUIRE_THAT(map_quality_warning(q), Contains("its poses may be wrong"));
  q.near = {20, 18, 1.5};
  REQUIRE_THAT(map_quality_warning(q), Contains("its poses may be wrong"));
  q.near_between_robots = {10, 0, std::nan("")};
  REQUIRE_THAT(map_quality_warning(q), Contains("the frames of the robots may be wrong"));
  q.near_between_robots = {9, 0, std::nan("")};  // too few to judge
  REQUIRE_THAT(map_quality_warning(q), Contains("its poses may be wrong"));

  q.revisits.resize(3);
  q.before.mean_m = 0.5;
  q.difference.mean_difference = -0.0001;
  REQUIRE_THAT(map_quality_text(q),
               Contains("revisits     3 of 12 pairs") && Contains("0.500 m in the mean") &&
                   Contains("difference   0.000 m\n") && Contains("thickness    not known"));
}

TEST_CASE("closure pairs: the ends of the loop closures alone", "[evaluation][map]") {
  PoseGraph graph = two_circles().graph;
  REQUIRE(closure_pairs(graph).empty());
  Edge edge;
  edge.from = make_key('b', 7);
  edge.to = make_key('a', 2);
  graph.add_edge(edge);
  REQUIRE(closure_pairs(graph) == Revisits{{make_key('b', 7), make_key('a', 2)}});
}

TEST_CASE("run folder: results of an earlier run are removed, other files stay", "[evaluation][run]") {
  const TemporaryFolder folder;
  testing::fs::create_directories(folder / "trajectories");
  for (const char* name : {"summary.json", "odometry.csv", "map.pcd", "map.ply", "picture.svg",
                           "trajectories/a.tum", "trajectories/notes.txt", "mine.txt"})
    write_text(folder / name, "x");
  remove_run_results(folder.path());
  remove_run_results(folder / "absent");
  std::size_t left = 0;
  for (const auto& entry : testing::fs::recursive_directory_iterator(folder.path()))
    left += entry.is_regular_file() ? 1 : 0;
  REQUIRE(left == 2);
  REQUIRE(testing::fs::exists(folder / "trajectories/notes.txt"));
  REQUIRE(testing::fs::exists(folder / "mine.txt"));
}

}  // namespace loopwise::summary_texts_test
