// SPDX-License-Identifier: BSD-3-Clause
#include <chrono>
#include <thread>

#include <nlohmann/json.hpp>

#include <loopwise/io/cloud.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/json_options.hpp>

#include "io/lamp_testing.hpp"
#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::convert_command_test {
namespace {

namespace fs = std::filesystem;
using testing::json_of;
using testing::lamp_data;
using testing::Program;
using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;

enum : int { kDone = 0, kBadUsage = 2, kBadInput = 3, kInterrupted = 130 };

TEST_CASE("convert: round trips, and other commands on the result", "[apps][convert]") {
  const TemporaryFolder folder;
  const Mission mission = small_mission(5);
  write_mission(folder / "m", mission);
  const std::string m = (folder / "m").string(), g = (folder / "g").string(),
                    again = (folder / "again").string();
  const Json there = json_of({"convert", m, "-o", g, "--to", "g2o_pcd", "--encoding", "ascii"});
  CHECK(there["kind"] == "mission");
  CHECK(there["to"] == "g2o_pcd");
  CHECK(there["nodes"] == 10);
  CHECK(there["scans"] == 10);
  CHECK(there["ground_truth"] == 10);
  CHECK(there["left_out"].empty());
  CHECK(there["problems"].empty());
  const Json back = json_of({"convert", g, "-o", again});
  CHECK(back["kind"] == "g2o_pcd");
  CHECK(back["to"] == "mission");
  for (const std::string& path : {m, g, again}) {
    const Json info = json_of({"info", path});
    CHECK(info["nodes"] == 10);
    CHECK(info["scans"] == 10);
    CHECK(info["problems"].empty());
    CHECK(info["kind"] == (path == g ? "g2o_pcd" : "mission"));
  }
  // The same mission gives the same bytes, on any number of threads.
  const std::string other = (folder / "other").string();
  json_of({"convert", g, "-o", other, "--threads", "3"});
  for (const auto& entry : fs::recursive_directory_iterator(again)) {
    if (!entry.is_regular_file()) continue;
    const fs::path twin = fs::path(other) / fs::relative(entry.path(), again);
    CHECK(read_file(entry.path()) == read_file(twin));
  }
  // A replay gives the same result from every format.
  const auto closures = [&](const std::string& path, const std::string& out) {
    const Json summary =
        json_of({"replay", path, "-o", (folder / out).string(), "--skip-recent", "2", "--workers", "2"});
    return std::pair(summary["closures"].dump(), summary["ate_m"]["optimized"].get<double>());
  };
  const auto [found, error] = closures(m, "run1");
  for (const std::string& path : {again, g}) {
    const auto [found_there, error_there] = closures(path, fs::path(path).filename().string() + "_run");
    CHECK(found_there == found);
    // Quaternions of text are normalised; registrations compute in floats, which amplify the last digit.
    CHECK(error_there == Approx(error).epsilon(1e-8));
  }
  CHECK(json_of({"rank", g})["candidates"] == json_of({"rank", m})["candidates"]);

  const Json tum = json_of({"convert", m, "-o", (folder / "tum").string(), "--to", "tum"});
  CHECK(tum["left_out"].size() == 4);
  const ProgramRun tum_run = run_program({"convert", m, "-o", (folder / "tum2").string(), "--to", "tum"});
  CHECK_THAT(tum_run.err,
             Contains("tum files hold the robots' poses and stamps alone; the mission also has: edge x 8"));
  CHECK_THAT(tum_run.err, !Contains("left out") && !Contains("times"));
  CHECK(json_of({"evaluate", (folder / "tum" / "a.tum").string(),
                 (folder / "tum" / "a_truth.tum").string()})["poses"] == 5);
}

TEST_CASE("convert: bad usage is 2, bad input 3, and neither leaves anything", "[apps][convert]") {
  const TemporaryFolder folder;
  write_mission(folder / "m", small_mission(3));
  const std::string m = (folder / "m").string(), out = (folder / "out").string();
  const auto fails = [&](const std::vector<std::string>& arguments, int status, const std::string& why) {
    const ProgramRun run = run_program(arguments);
    CAPTURE(arguments);
    CHECK(run.status == status);
    CHECK(run.out.empty());
    CHECK_THAT(run.err, Contains(why));
    CHECK_FALSE(fs::exists(out));
  };
  fails({"convert", m}, kBadUsage, "--output");
  fails({"convert", m, "-o", m}, kBadUsage, "not empty");
  fails({"convert", m, "-o", out, "--to", "rosbag"}, kBadUsage,
        "must be one of: mission, g2o_pcd, tum, kitti");
  fails({"convert", m, "-o", out, "--to", "glim"}, kBadUsage, "values.bin and graph.bin");
  fails({"convert", m, "-o", out, "--to", "glim"}, kBadUsage, "Write the poses by --to tum");
  fails({"convert", m, "-o", out, "--encoding", "zip"}, kBadUsage, "--encoding");
  fails({"convert", m, "-o", out, "--frames", "f.csv"}, kBadUsage, "one is given");
  fails({"info", m, m, "--frames", "auto"}, kBadUsage, "frames = \"auto\"");
  fails({"convert", (folder / "none").string(), "-o", out}, kBadInput, "none");
  testing::write_text(folder / "cut.bag", "#ROSBAG V2.0\n");
  fails({"convert", (folder / "cut.bag").string(), "-o", out}, kBadInput, "cut.bag");
  testing::write_text(folder / "cut.zip", std::string("PK\x03\x04", 4));
  fails({"info", (folder / "cut.zip").string()}, kBadInput, "cut.zip");
}

TEST_CASE("convert: interrupted, nothing is kept", "[apps][convert]") {
  const TemporaryFolder folder;
  const std::string out = (folder / "out").string();
  const std::string sample = std::string(LOOPWISE_SOURCE_DIR) + "/data/sample_mission";
  Program program({"convert", sample, "-o", out, "--threads", "1"});
  while (program.running() && !fs::exists(fs::path(out) / "scans")) std::this_thread::yield();
  program.interrupt();
  const ProgramRun run = program.finish();
  if (run.status == kDone) {  // it was faster
    CHECK(fs::exists(fs::path(out) / "mission.json"));
    return;
  }
  INFO(run.err);
  CHECK(run.status == kInterrupted);
  CHECK_FALSE(fs::exists(out));
}

TEST_CASE("convert: bags and sessions from the command line", "[apps][convert]") {
  const TemporaryFolder folder;
  if (!lamp_data("sessions", folder / "s", "--nodes 4")) return;
  const std::string s0 = (folder / "s" / "session0").string(), s1 = (folder / "s" / "session1").string(),
                    s2 = (folder / "s" / "session2").string(),
                    frames = (folder / "s" / "frames.csv").string();
  const Json joined = json_of(
      {"convert", s0, s1, s2, "-o", (folder / "team").string(), "--frames", frames, "--start-together"});
  CHECK(joined["kind"] == "joined");
  CHECK(joined["robots"] == Json({"session0", "session1", "session2"}));
  const Json direct = json_of({"info", s0, s1, s2, "--frames", frames, "--start-together"});
  const Json written = json_of({"info", (folder / "team").string()});
  for (const char* field :
       {"nodes", "edges", "priors", "scans", "points", "duration_s", "length_m", "ground_truth"}) {
    CAPTURE(field);
    CHECK(direct[field] == written[field]);
  }
  CHECK(json_of({"replay", s0, s1, s2, "-o", (folder / "run").string(), "--method", "odom",
                 "--start-together", "--frames", "common"})
            .contains("ate_m"));

  if (!lamp_data("bags", folder / "b")) return;
  const Json info = json_of({"info", (folder / "b" / "rosbag").string()});
  CHECK(info["kind"] == "rosbag");
  CHECK(info["nodes"] == 12);
  CHECK(info["scans"] == 12);
  CHECK(info["problems"].empty());
  const Json converted =
      json_of({"convert", (folder / "b" / "rosbag" / "husky3.bag").string(),
               (folder / "b" / "rosbag" / "spot1.bag").string(), "-o", (folder / "mission").string()});
  CHECK(converted["scans"] == 12);
  CHECK(converted["ground_truth"] == 12);
  CHECK(json_of({"info", (folder / "mission").string()})["length_m"] == info["length_m"]);
}

TEST_CASE("convert: sweeps become key frames as the command line says", "[apps][convert][key_frames]") {
  const TemporaryFolder folder;
  fs::create_directories(folder / "run");
  PointCloud cloud;
  cloud.points = {Eigen::Vector3f(1.0f, 2.0f, 0.5f), Eigen::Vector3f(-3.0f, 1.0f, 0.5f)};
  std::string poses;
  for (int i = 0; i < 30; ++i) {
    const std::string stamp = std::to_string(1'600'000'000 + i);
    write_pcd(folder / "run" / (stamp + ".pcd"), cloud);
    poses += stamp + " " + std::to_string(0.5 * i) + " 0 0 0 0 0 1\n";
  }
  write_file(folder / "poses.tum", poses);
  const std::string run = (folder / "run").string(), tum = (folder / "poses.tum").string();
  const Json info = json_of({"info", run, "--poses", tum});
  CHECK(info["kind"] == "stamped_clouds");
  CHECK(info["nodes"] == 15);
  const Json made = json_of({"convert", run, "-o", (folder / "m").string(), "--poses", tum,
                             "--keyframe-distance", "5", "--submap", "3"});
  CHECK(made["nodes"] == 3);
  CHECK(run_program({"info", run, "--poses", tum, "--keyframe-distance", "-1"}).status == kBadUsage);
  CHECK(run_program({"info", run}).status == kBadInput);
}

}  // namespace
}  // namespace loopwise::convert_command_test
