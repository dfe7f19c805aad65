// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <map>

#include <nlohmann/json.hpp>

#include <loopwise/io/cloud.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/live_replay.hpp>

#include "testing_mission.hpp"

namespace loopwise::live_replay_test {
namespace {

using testing::OracleRegistrar;
using testing::two_circles;
using testing::with_landmark;

ReplayOptions live_config(const std::string& method) {
  ReplayOptions config;
  config.prioritization.method = parse_method(method);
  config.batch = 20;
  config.prioritization.observability.min_sum = 0.0;
  return config;
}

double mean_error(const Mission& mission, const PoseGraph& graph,
                  const std::vector<Eigen::Isometry3d>& poses) {
  double sum = 0.0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    sum += (poses[i].translation() - mission.ground_truth.at(graph.nodes()[i].key).translation()).norm();
  }
  return sum / static_cast<double>(poses.size());
}

}  // namespace

TEST_CASE("live replay: the online module sees the whole mission", "[replay][live]") {
  const Mission mission = two_circles();
  for (const char* method : {"odom", "random", "full"}) {
    CAPTURE(method);
    ReplayOptions config = live_config(method);
    config.after_mission = true;
    RealClock clock(0.0, 1000.0);  // 78.5 s of mission
    std::size_t moments = 0, outcomes = 0;
    double time = 0.0;
    std::vector<std::string> journal;
    ReplayHooks hooks;
    hooks.moment = [&](const ReplayMoment& moment) {
      ++moments;
      REQUIRE(moment.odometry.size() >= moment.graph.nodes().size());
      REQUIRE(moment.mission_time_s >= time);
      time = moment.mission_time_s;
    };
    hooks.outcome = [&](const RegistrationResult&) { ++outcomes; };
    hooks.journal = [&](const std::string& line) { journal.push_back(line); };
    const ReplayResult result = replay_live(
        mission, config, std::make_shared<OracleRegistrar>(mission.ground_truth), clock, 2, hooks);
    REQUIRE_FALSE(result.interrupted);
    REQUIRE(result.graph.nodes().size() == mission.graph.nodes().size());
    REQUIRE(result.odometry.size() == result.graph.nodes().size());
    REQUIRE(result.accounting.balanced());
    REQUIRE(result.accounting.pending == 0);
    REQUIRE(result.accounting.in_flight == 0);
    REQUIRE(result.computed.size() == result.accounting.computed);
    REQUIRE(outcomes == result.computed.size());
    REQUIRE(parse_json(journal.front(), "journal").at("event") == "start");
    REQUIRE(parse_json(journal.back(), "journal").at("event") == "end");
    REQUIRE(journal.size() == outcomes + 2);
    REQUIRE(result.mission_end_s == 78.5);
    REQUIRE(result.mission_time_s >= 78.5);
    REQUIRE(moments >= 1);
    const double odometry = mean_error(mission, result.graph, result.odometry),
                 optimized = mean_error(mission, result.graph, result.graph.poses());
    if (std::string(method) == "odom") {
      REQUIRE(result.computed.empty());
      REQUIRE(optimized == Approx(odometry));
      continue;
    }
    REQUIRE(odometry > 0.4);
    REQUIRE(optimized < 0.1);  // measured 0.02, as on the virtual clock
    for (const ComputedCandidate& c : result.computed) {
      REQUIRE((c.weight == 0.0 || c.result.verified()));
      REQUIRE(c.mission_time_s > 0.0);
    }
    REQUIRE(std::any_of(result.computed.begin(), result.computed.end(),
                        [](const ComputedCandidate& c) { return c.weight > 0.5; }));
  }
}

TEST_CASE("live replay: scans that vanish before they are asked for are named, nothing is lost",
          "[replay][live][error]") {
  const testing::TemporaryFolder folder;
  Mission mission = two_circles();
  std::map<Key, testing::fs::path> files;
  for (const Key key : mission.graph.keys()) {
    files[key] = folder / (std::to_string(key) + ".pcd");
    write_pcd(files[key], *mission.scans->load(key));
  }
  mission.scans = std::make_shared<ScanStore>(files, 0);
  ReplayOptions config = live_config("baseline");
  config.after_mission = true;
  config.registration.features.max_cache_mb = 0.0;
  const Registration registration = make_registration(config.registration, mission.scans->loader());
  std::size_t key_frames = 0;
  ReplayHooks hooks;
  hooks.progress = [&](const Progress& progress) {  // after each key frame
    if (progress.done <= key_frames) return;
    key_frames = progress.done;
    if (key_frames % 10 == 0) {
      testing::fs::remove(files.at(make_key('a', 25 + key_frames / 10)));  // to come
      testing::fs::remove(files.at(make_key('b', key_frames / 10)));       // has come
    }
  };
  RealClock clock(0.0, 1000.0);
  const ReplayResult result = replay_live(mission, config, registration.registrar, clock, 2, hooks);
  REQUIRE(result.graph.nodes().size() == mission.graph.nodes().size());
  REQUIRE(result.accounting.balanced());
  REQUIRE(result.accounting.pending + result.accounting.in_flight == 0);
  REQUIRE(result.computed.size() == result.accounting.computed);
  REQUIRE(result.problems.count("scan cannot be read") > 0);
  bool named = false;
  for (const Problem& problem : result.problems.all())
    named = named || Contains(".pcd: No such file").match(problem.example);
  REQUIRE(named);
}

TEST_CASE("live replay: registrations are kept if the back end fails", "[replay][live][error]") {
  Mission mission = two_circles();
  PriorFactor absurd = mission.graph.priors().front();  // its cost is beyond a double
  absurd.pose.translation().x() += 1e6;
  absurd.information = 1e300 * Matrix6d::Identity();
  mission.graph.add_prior(absurd);
  ReplayOptions config = live_config("baseline");
  config.after_mission = true;
  std::size_t ends = 0;
  ReplayHooks hooks;
  hooks.moment = [&](const ReplayMoment& moment) { ends += moment.kind == ReplayMoment::Kind::kEnd ? 1 : 0; };
  RealClock clock(0.0, 1000.0);
  const ReplayResult result =
      replay_live(mission, config, std::make_shared<OracleRegistrar>(mission.ground_truth), clock, 2, hooks);
  REQUIRE(ends == 1);
  REQUIRE_FALSE(result.computed.empty());
  REQUIRE(result.computed.size() == result.accounting.computed);
  REQUIRE(result.graph.nodes().size() == mission.graph.nodes().size());
  bool reported = false;
  for (const Problem& problem : result.problems.all())
    reported = reported || Contains("the back end failed").match(problem.example);
  REQUIRE(reported);
  for (const Eigen::Isometry3d& pose : result.graph.poses()) REQUIRE(pose.matrix().allFinite());
}

TEST_CASE("live replay: landmarks, ranges and gravity take part", "[replay][live]") {
  const Mission mission = testing::with_landmark(two_circles());
  RealClock clock(0.0, 1000.0);
  const ReplayResult result = replay_live(
      mission, live_config("odom"), std::make_shared<OracleRegistrar>(mission.ground_truth), clock, 2, {});
  REQUIRE(result.graph.nodes().size() == mission.graph.nodes().size());
  REQUIRE(result.graph.edges().size() == mission.graph.edges().size());
  REQUIRE(result.graph.ranges().size() == mission.graph.ranges().size());
  REQUIRE(result.graph.gravities().size() == mission.graph.gravities().size());
}

TEST_CASE("live replay: odometry is that of the virtual clock", "[replay][live]") {
  Mission mission = two_circles();
  mission.gaps = {{1, 10.0, 50.0}};
  const ReplayOptions config = live_config("odom");
  RealClock clock(0.0, 1000.0);
  const auto registrar = std::make_shared<OracleRegistrar>(mission.ground_truth);
  const ReplayResult live = replay_live(mission, config, registrar, clock, 1);
  ThreadPool pool(1);
  const ReplayResult modelled =
      MissionReplay(
          mission, config,
          {std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features), registrar})
          .run(pool);
  REQUIRE(live.odometry.size() == modelled.odometry.size());
  for (std::size_t i = 0; i < live.odometry.size(); ++i) {
    REQUIRE(live.graph.nodes()[i].key == modelled.graph.nodes()[i].key);
    REQUIRE(live.odometry[i].matrix() == modelled.odometry[i].matrix());
  }
}

TEST_CASE("live replay: a stop request ends it soon, with the results so far", "[replay][live]") {
  const Mission mission = two_circles();
  ReplayOptions config = live_config("random");
  config.after_mission = true;
  RealClock clock(0.0, 1.0);  // 78.5 s, which the test does not wait for
  StopSource stop;
  ReplayHooks hooks;
  hooks.stop = stop.token();
  hooks.progress = [&](const Progress& p) {
    if (p.done == 3) stop.request_stop();
  };
  const ReplayResult result =
      replay_live(mission, config, std::make_shared<OracleRegistrar>(mission.ground_truth), clock, 1, hooks);
  REQUIRE(result.interrupted);
  REQUIRE(result.graph.nodes().size() == 3);
  REQUIRE(result.accounting.balanced());
}

TEST_CASE("live replay: a failing journal loses no results", "[replay][live][error]") {
  const Mission mission = two_circles();
  ReplayOptions config = live_config("random");
  config.after_mission = true;
  RealClock clock(0.0, 1000.0);
  std::size_t lines = 0;
  ReplayHooks hooks;
  hooks.journal = [&](const std::string&) {
    if (++lines > 1) throw IoError("journal.jsonl", "No space left on device");
  };
  const ReplayResult result =
      replay_live(mission, config, std::make_shared<OracleRegistrar>(mission.ground_truth), clock, 1, hooks);
  REQUIRE(result.graph.nodes().size() == mission.graph.nodes().size());
  REQUIRE(result.accounting.balanced());
  REQUIRE(result.computed.size() == result.accounting.computed);
  REQUIRE(result.computed.size() > 0);
  REQUIRE(result.problems.count("live") == lines - 1);
}

TEST_CASE("live replay: options of the virtual clock alone are refused", "[replay][live][error]") {
  const Mission mission = two_circles();
  const auto registrar = std::make_shared<OracleRegistrar>(mission.ground_truth);
  RealClock clock(0.0, 1000.0);
  const auto require_refused = [&](auto&& change, const std::string& name) {
    ReplayOptions config = live_config("random");
    change(config);
    REQUIRE_THROWS_WITH(replay_live(mission, config, registrar, clock, 1), Contains(name));
  };
  require_refused([](ReplayOptions& r) { r.max_registrations = 5; }, "replay.max_registrations");
  require_refused([](ReplayOptions& r) { r.cost.measured_time = true; }, "cost.measured_time");
  require_refused([](ReplayOptions& r) { r.cost.refused_time_share = 0.0; }, "cost.refused_time_share");
  REQUIRE_THROWS_AS(replay_live(mission, live_config("random"), nullptr, clock, 1), InputError);
}

}  // namespace loopwise::live_replay_test
