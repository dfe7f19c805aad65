// SPDX-License-Identifier: BSD-3-Clause
// The input of runs: fingerprints, headers of traces, single clouds; and the table of a ranking.
#include <limits>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/cloud_pair.hpp>
#include <loopwise/replay/outcome_file.hpp>
#include <loopwise/replay/rank.hpp>
#include <loopwise/replay/trace.hpp>

#include "registration/scene.hpp"
#include "testing_mission.hpp"

namespace loopwise::run_input_test {
namespace {

using testing::TemporaryFolder;
using testing::two_circles;
using testing::write_text;

}  // namespace

TEST_CASE("run fingerprint: changes with the mission and the options", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const Config config;
  const std::string same = run_fingerprint(mission, config);
  REQUIRE(run_fingerprint(two_circles(), config) == same);
  REQUIRE(same.find('\n') == std::string::npos);
  REQUIRE(parse_json(same, "fingerprint").at("mission") == mission.name);

  std::set<std::string> all{same};
  Mission renamed = mission;
  renamed.name = "other";
  all.insert(run_fingerprint(renamed, config));
  Mission moved = mission;
  Eigen::Isometry3d pose = mission.graph.nodes()[3].pose;
  pose.translation().x() += 1e-9;
  moved.graph.set_pose(mission.graph.nodes()[3].key, pose);
  all.insert(run_fingerprint(moved, config));
  Mission without_scans = mission;
  without_scans.scans = std::make_shared<ScanStore>();
  all.insert(run_fingerprint(without_scans, config));
  Config other = config;
  other.replay.engine.seed += 1;
  all.insert(run_fingerprint(mission, other));
  REQUIRE(all.size() == 5);
}

TEST_CASE("trace: the header of a file", "[replay][trace]") {
  const TemporaryFolder folder;
  const Mission mission = two_circles();
  ModuleOptions options;
  options.engine.seed = 77;
  std::string lines;
  const TraceWriter writer(mission.robots, options, [&](const std::string& line) { lines += line + "\n"; });
  write_text(folder / "run.trace", lines);
  const TraceHeader header = read_trace_header(folder / "run.trace");
  REQUIRE(header.robots.size() == 2);
  REQUIRE(header.options.engine.seed == 77);

  const std::string absent = (folder / "absent").string(), other = (folder / "other").string();
  REQUIRE_THROWS_WITH(read_trace_header(absent), absent + ": cannot be read");
  write_text(other, "{}\n");
  REQUIRE_THROWS_AS(read_trace_header(other), ParseError);
  REQUIRE_THROWS_WITH(read_trace_header(other), Contains(other + ":1: "));
}

TEST_CASE("rank: the table has all candidates, the ranked ones first", "[replay][rank]") {
  Ranking ranking;
  CandidateScores first;
  first.candidate.from = make_key('a', 9);
  first.candidate.to = make_key('b', 1);
  first.candidate.distance_m = 2.5;
  first.rank = 1;
  first.gain_m2 = 0.125;
  CandidateScores connecting = first;
  connecting.rank.reset();
  connecting.connecting = true;
  connecting.refused = "too near, by far";
  connecting.observability_from = std::numeric_limits<double>::quiet_NaN();
  ranking.candidates = {first, connecting};
  const CsvTable table = CsvTable::parse(ranking_csv(ranking), "ranking",
                                         {"rank", "from", "to", "source", "distance_m", "observability_from",
                                          "observability_to", "gain_m2", "connecting", "refused"});
  REQUIRE(table.size() == 2);
  REQUIRE(table.integer(0, 0) == 1);
  REQUIRE(table.key(0, 1) == make_key('a', 9));
  REQUIRE(table.key(0, 2) == make_key('b', 1));
  REQUIRE(table.number(0, 4) == 2.5);
  REQUIRE(table.number(0, 7) == 0.125);
  REQUIRE(table.integer(0, 8) == 0);
  REQUIRE(table.text(0, 9).empty());
  REQUIRE(table.text(1, 0).empty());
  REQUIRE(table.text(1, 5).empty());
  REQUIRE(table.integer(1, 8) == 1);
  REQUIRE(table.text(1, 9) == "too near, by far");
}

TEST_CASE("cloud pair: the pose is the same far from zero as at zero", "[replay][registration]") {
  const testing::Scene scene(4);
  Rng rng(5);
  const Eigen::Isometry3d T_w_source = testing::ground_pose(1.0, 0.5, 0.1),
                          T_w_target = testing::ground_pose(0.0, 0.0, 0.0);
  const std::shared_ptr<PointCloud> source = scene.scan(T_w_source, 3000, rng),
                                    target = scene.scan(T_w_target, 3000, rng);
  const CloudPairResult near = register_clouds(source, target);
  REQUIRE(near.result.verified());
  REQUIRE(near.origins.zero());
  const Eigen::Isometry3d truth = T_w_target.inverse() * T_w_source;
  // Scans have 2 cm noise.
  REQUIRE((near.T_coordinates->translation() - truth.translation()).norm() < 0.1);
  REQUIRE(near.T_coordinates->matrix() == near.T_origins->matrix());
  REQUIRE(near.covariance);
  REQUIRE(near.covariance->diagonal().minCoeff() > 0.0);

  // The same points in world coordinates: the registration sees the same floats.
  const auto far_source = std::make_shared<PointCloud>(*source),
             far_target = std::make_shared<PointCloud>(*target);
  far_source->origin = Eigen::Vector3d(432100.0, 5432110.0, 30.0);
  far_target->origin = far_source->origin + Eigen::Vector3d(3.0, -2.0, 0.0);
  const CloudPairResult far = register_clouds(far_source, far_target);
  REQUIRE(far.origins.target == far_target->origin);
  REQUIRE(far.origins.source == far_target->origin);
  REQUIRE(far.T_clouds->matrix() == near.T_clouds->matrix());
  const Eigen::Vector3d point = far_source->origin + source->points[0].cast<double>();
  const Eigen::Vector3d expected = far_target->origin + *far.T_clouds * source->points[0].cast<double>();
  REQUIRE((*far.T_coordinates * point - expected).norm() < 1e-6);
  REQUIRE((*far.T_origins * (point - far.origins.source) + far.origins.target - expected).norm() < 1e-6);

  // A guess is in the coordinates of the clouds.
  const CloudPairResult guessed = register_clouds(far_source, far_target, {}, far.T_coordinates);
  REQUIRE(guessed.result.verified());
  REQUIRE(testing::difference(*guessed.T_clouds, *far.T_clouds) < 0.1);
}

TEST_CASE("cloud pair: a pair that cannot be aligned has a reason and no pose", "[replay][registration]") {
  const auto few = std::make_shared<PointCloud>();
  few->points = {{1.0F, 0.0F, 0.0F}, {0.0F, 1.0F, 0.0F}, {9e6F, 0.0F, 0.0F}};
  const CloudPairResult pair = register_clouds(few, few);
  REQUIRE_FALSE(pair.result.verified());
  REQUIRE(pair.result.reason == RejectionReason::kTooFewPoints);
  REQUIRE_FALSE(pair.T_clouds);
  REQUIRE_FALSE(pair.covariance);
  REQUIRE(pair.far_points_source == 1);
  REQUIRE(pair.far_points_target == 1);
}

}  // namespace loopwise::run_input_test
