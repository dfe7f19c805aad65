// SPDX-License-Identifier: BSD-3-Clause
// Ground truth, and the results of other programs, on the command line.
#include <nlohmann/json.hpp>

#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::truth_test {
namespace {

namespace fs = std::filesystem;
using testing::json_of;
using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;

/// A session of one robot: odometry that drifts, and optimised poses that are worse.
void write_session(const fs::path& folder, const Mission& mission) {
  fs::create_directories(folder / "Scans");
  std::vector<Eigen::Isometry3d> odometry, optimized;
  std::string times;
  for (std::uint64_t i = 0; i < mission.graph.nodes().size() / 2; ++i) {
    const Node& node = mission.graph.node(make_key('a', i));
    odometry.push_back(node.pose);
    optimized.push_back(mission.ground_truth.at(node.key));
    optimized.back().translation().y() += 0.4 * static_cast<double>(i);
    times += std::to_string(node.stamp_ns / 1'000'000'000) + ".0\n";
    std::string name = std::to_string(i);
    name.insert(0, 6 - name.size(), '0');
    write_pcd(folder / "Scans" / (name + ".pcd"), *mission.scans->load(node.key));
  }
  write_kitti(folder / "odom_poses.txt", odometry);
  write_kitti(folder / "optimized_poses.txt", optimized);
  testing::write_text(folder / "times.txt", times);
}

/// True poses of robot a by stamp.
void write_truth(const fs::path& file, const Mission& mission) {
  std::vector<StampedPose> poses;
  for (const auto& [key, pose] : mission.ground_truth) {
    if (key_character(key) == 'a') poses.push_back({mission.graph.node(key).stamp_ns, pose});
  }
  write_tum(file, poses);
}

}  // namespace

TEST_CASE("truth: a session's own optimised poses are a reference everywhere", "[apps][truth]") {
  const TemporaryFolder folder;
  write_session(folder / "s", small_mission(8));
  const std::string session = (folder / "s").string(), out = (folder / "out").string();
  ProgramRun run = run_program({"info", session, "--picture", (folder / "s.svg").string()});
  INFO(run.err);
  REQUIRE(run.status == 0);
  CHECK_THAT(run.out, Contains("truth        0 poses") &&
                          Contains("reference    8 poses that another program optimised, not the truth") &&
                          !Contains("drift"));
  CHECK_THAT(testing::read_text(folder / "s.svg"),
             Contains("optimised by another program") && !Contains("truth"));
  CHECK(json_of({"info", session})["reference"] == 8);
  CHECK(json_of({"info", session})["ground_truth"] == 0);

  run = run_program({"replay", session, "-o", out, "--skip-recent", "2", "--after-mission"});
  INFO(run.err);
  REQUIRE(run.status == 0);
  CHECK_THAT(run.out, Contains("mean difference from the session's own optimised poses") &&
                          Contains("residuals ") && !Contains("ATE") && !Contains("true inliers"));
  const Json summary = parse_json(testing::read_text(folder / "out" / "summary.json"), "summary.json");
  CHECK(summary["truth"].is_null());
  CHECK(summary["ate_m"].is_null());
  CHECK(summary["reference"]["poses"] == 8);

  run = run_program({"evaluate", out, session});
  CHECK(run.status == 3);
  CHECK_THAT(run.err,
             Contains("no ground truth is recorded there; the session's own optimised poses are another"));
  CHECK(json_of({"evaluate", out, session + "/optimized_poses.txt"})["poses"] == 8);
  run = run_program({"study", "registration", session});
  CHECK(run.status == 3);
  CHECK_THAT(run.err, Contains("its own optimised poses are another program's result"));

  // A mission folder made from it keeps the reference as a reference.
  run = run_program({"convert", session, "-o", (folder / "m").string()});
  REQUIRE(run.status == 0);
  CHECK_THAT(run.out, Contains("0 true poses"));
  CHECK(json_of({"info", (folder / "m").string()})["reference"] == 8);
  CHECK_FALSE(fs::exists(folder / "m" / "ground_truth.g2o"));
}

TEST_CASE("truth: --truth gives the true poses", "[apps][truth]") {
  const TemporaryFolder folder;
  const Mission mission = small_mission(8);
  write_session(folder / "s", mission);
  write_truth(folder / "truth.tum", mission);
  const std::string session = (folder / "s").string(), truth = (folder / "truth.tum").string();
  const Json info = json_of({"info", session, "--truth", truth});
  CHECK(info["ground_truth"] == 8);
  CHECK(info["drift"].size() == 1);
  // Candidates of one robot are ten nodes apart at least.
  const Mission longer = small_mission(24);
  write_session(folder / "longer", longer);
  write_truth(folder / "longer.tum", longer);
  CHECK(json_of({"info", (folder / "longer").string(), "--truth", (folder / "longer.tum").string()})
            .at("candidates")
            .at("looked_at")
            .get<int>() > 0);

  const std::vector<std::string> few{"--skip-recent", "2", "--after-mission"};
  const auto replayed = [&](const std::string& out, std::vector<std::string> more) {
    more.insert(more.begin(), {"replay", session, "-o", (folder / out).string()});
    more.insert(more.end(), few.begin(), few.end());
    return json_of(more);
  };
  const Json evaluated = replayed("evaluated", {"--truth", truth}), plain = replayed("plain", {});
  CHECK(evaluated["truth"]["file"] == truth);
  CHECK(evaluated["ate_m"]["optimized"].get<double>() < 0.5);
  CHECK(evaluated["closures"]["true_inliers"].is_number());
  CHECK(evaluated["reference"]["poses"] == 8);
  // The ground truth does not change results.
  for (const char* file : {"graph.g2o", "journal.jsonl"})
    CHECK(testing::read_text(folder / "evaluated" / file) == testing::read_text(folder / "plain" / file));
  CHECK(json_of(
            {"evaluate", (folder / "evaluated" / "trajectories" / "0.tum").string(), truth})["ate_m"]["mean"]
            .get<double>() == Approx(evaluated["ate_m"]["optimized"].get<double>()).epsilon(1e-6));

  const Json study =
      json_of({"study", "ablation", session, "-o", (folder / "study").string(), "--truth", truth, "--methods",
               "baseline", "--skip-recent", "2", "--max-registrations", "3"});
  CHECK(study.contains("worlds"));
  // Another truth, another unit.
  Mission other = mission;
  for (auto& [key, pose] : other.ground_truth) pose.translation().z() += 0.1;
  write_truth(folder / "truth.tum", other);
  const ProgramRun again =
      run_program({"study", "ablation", session, "-o", (folder / "study").string(), "--truth", truth,
                   "--methods", "baseline", "--skip-recent", "2", "--max-registrations", "3"});
  REQUIRE(again.status == 0);
  CHECK_THAT(again.err, !Contains("finished already"));

  const auto fails = [](const std::vector<std::string>& arguments, int status, const std::string& why) {
    const ProgramRun run = run_program(arguments);
    CAPTURE(arguments);
    CHECK(run.status == status);
    CHECK_THAT(run.err, Contains(why));
  };
  fails({"info", session, "--truth", "b=" + truth}, 2, "no robot is called \"b\", the robots are 0");
  fails({"report", (folder / "evaluated").string(), "-o", (folder / "r.html").string(), "--truth", truth}, 2,
        "--truth needs --mission");
}

TEST_CASE("truth: a session without stamps is not paired by stamp", "[apps][truth][error]") {
  const TemporaryFolder folder;
  const Mission mission = small_mission(8);
  write_session(folder / "s", mission);
  write_truth(folder / "truth.tum", mission);
  fs::remove(folder / "s" / "times.txt");
  const std::string session = (folder / "s").string(), truth = (folder / "truth.tum").string();
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{"info", session, "--truth", truth},
        {"replay", session, "-o", (folder / "out").string(), "--truth", truth},
        {"evaluate", session, truth}}) {
    CAPTURE(arguments.front());
    const ProgramRun run = run_program(arguments);
    CHECK(run.status == 3);
    CHECK_THAT(run.err, Contains("truth.tum: pairs by stamp") && Contains("times.txt") &&
                            Contains("give the recorded stamps"));
  }
}

TEST_CASE("truth: a study reports where errors are measured, and against which truth",
          "[apps][truth][study]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(8);
  std::vector<Eigen::Isometry3d> rows;
  for (std::uint64_t i = 0; i < 8; ++i) rows.push_back(mission.ground_truth.at(make_key('a', i)));
  write_kitti(folder / "a.kitti", rows);
  mission.ground_truth.clear();
  write_mission(folder / "m", mission);
  const auto studied = [&](const std::string& robot) {
    return run_program({"study", "ablation", (folder / "m").string(), "-o", (folder / "study").string(),
                        "--truth", robot + "=" + (folder / "a.kitti").string(), "--methods", "baseline",
                        "--skip-recent", "2", "--max-registrations", "3"});
  };
  ProgramRun run = studied("a");
  INFO(run.err);
  REQUIRE(run.status == 0);
  CHECK_THAT(run.out, Contains("positions in the common frame without alignment"));
  CHECK_THAT(testing::read_text(folder / "study" / "runs.csv"),
             Contains(",truth_alignment,") && Contains(",none,"));
  // The same file as the truth of the other robot: begins elsewhere.
  run = studied("b");
  REQUIRE(run.status == 0);
  CHECK_THAT(run.err, !Contains("finished already"));
  CHECK_THAT(run.out, Contains("positions after the best rigid motion") && !Contains("without alignment"));
  CHECK_THAT(testing::read_text(folder / "study" / "runs.csv"), Contains(",se3,"));
}

TEST_CASE("truth: without it, maps are compared at common revisits", "[apps][truth][map]") {
  const TemporaryFolder folder;
  const Mission mission = small_mission(12);
  write_mission(folder / "m", mission);
  const std::string recording = (folder / "m").string();
  const auto write_estimate = [&](const char* name, std::uint64_t nodes, char robot) {
    PoseGraph graph;
    for (Node node : mission.graph.nodes()) {
      const std::uint64_t index = key_index(node.key);
      if (index >= nodes) continue;
      if (robot != 0) node.key = make_key(robot, index);
      if (!graph.contains(node.key)) graph.add_node(node);
    }
    for (const Edge& edge : mission.graph.edges()) {
      if (graph.contains(edge.from) && graph.contains(edge.to)) graph.add_edge(edge);
    }
    write_g2o(folder / name, graph);
    return (folder / name).string();
  };
  const Json whole = json_of({"evaluate", "--map", write_estimate("whole.g2o", 12, 0), recording});
  CHECK(whole["revisits"].get<int>() > 0);
  CHECK(whole["revisits"].get<int>() <= whole["pairs"].get<int>());
  CHECK(whole["stretches"].get<int>() > 0);
  CHECK(whole["stretches"].get<int>() < whole["revisits"].get<int>());
  CHECK(whole["difference_m"] == 0.0);
  // A yard of 24 m has two path sections: too few, so a warning is printed and no interval.
  CHECK(whole["enough_for_interval"] == false);
  CHECK(whole["difference_interval_95"][0].is_null());
  const ProgramRun shown = run_program({"evaluate", "--map", (folder / "whole.g2o").string(), recording});
  CHECK_THAT(shown.err, Contains("too few for a confidence interval"));
  CHECK_THAT(shown.out, !Contains("95 %") && !Contains("-0.0") && Contains("an upper bound"));
  // An estimate with the same poses but fewer nodes is as good.
  const Json part = json_of({"evaluate", "--map", write_estimate("part.g2o", 8, 0), recording});
  CHECK(part["revisits"].get<int>() > 0);
  CHECK(part["revisits"].get<int>() < whole["revisits"].get<int>());
  CHECK(part["share_on_surfaces"]["recording"] == part["share_on_surfaces"]["estimate"]);
  CHECK(part["difference_m"] == 0.0);

  const auto fails = [](const std::vector<std::string>& arguments, int status, const std::string& why) {
    const ProgramRun run = run_program(arguments);
    CAPTURE(arguments);
    CHECK(run.status == status);
    CHECK_THAT(run.err, Contains(why));
  };
  const std::string other = write_estimate("other.g2o", 8, 'z');
  fails({"evaluate", "--map", other, recording}, 3, "other.g2o: has no node of");
  fails({"evaluate", "--map", other, recording, "--alignment", "se3"}, 2, "--alignment");
  fails({"evaluate", "--map", other, recording, "--max-time-difference", "1"}, 2, "--max-time-difference");
  fails({"evaluate", "--map", other, recording, "--robots", "c,d"}, 3, "a0");
}

TEST_CASE("truth: the poses of a real session are not ground truth", "[apps][truth][data]") {
  for (const char* name : {"hku1", "scpgo_a"}) {
    const auto path = testing::test_data(name);
    if (!path) continue;
    const Json info = json_of({"info", path->string(), "--no-scans"});
    CHECK(info["ground_truth"] == 0);
    CHECK(info["reference"] == info["nodes"]);
    CHECK(info["drift"].empty());
  }
}

}  // namespace loopwise::truth_test
