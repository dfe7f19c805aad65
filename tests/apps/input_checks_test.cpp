// SPDX-License-Identifier: BSD-3-Clause
// Input that a command cannot use, or that fits something else: it is named, and nothing is lost.
#include <string>
#include <vector>

#include <loopwise/io/convert.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>

#include "program.hpp"
#include "small_mission.hpp"

namespace loopwise::input_checks_test {
namespace {

using Catch::Matchers::Contains;
using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;

constexpr int kDone = 0, kBadUsage = 2, kBadInput = 3;

TEST_CASE("replay: files that do not fit the mission cost no former results", "[apps][replay][error]") {
  const TemporaryFolder folder;
  write_mission(folder / "m", small_mission(8));
  testing::write_text(folder / "pairs.csv", "from,to\na1,z9\n");
  testing::write_text(folder / "not_a_folder", "x");
  const std::vector<std::string> replay{
      "replay", (folder / "m").string(), "--skip-recent", "2", "--max-registrations", "2", "--overwrite"};
  const auto run = [&](const std::string& out, std::vector<std::string> more) {
    std::vector<std::string> all = replay;
    all.insert(all.end(), {"-o", (folder / out).string()});
    all.insert(all.end(), more.begin(), more.end());
    return run_program(all);
  };
  REQUIRE(run("out", {}).status == kDone);
  const std::string before = testing::read_text(folder / "out" / "summary.json");
  const std::vector<std::vector<std::string>> wrong{
      {"--candidates", (folder / "pairs.csv").string()},
      {"--candidates", (folder / "absent.csv").string()},
      {"--decisions", (folder / "absent.csv").string()},
      {"--outcomes", (folder / "not_a_folder").string()},
      {"--candidates", (folder / "pairs.csv").string(), "--clock", "real", "--rate", "100"}};
  for (const std::vector<std::string>& more : wrong) {
    CAPTURE(more);
    const ProgramRun failed = run("out", more);
    REQUIRE(failed.status == kBadInput);
    REQUIRE_THAT(failed.err, Contains(more[1]));
    REQUIRE(testing::read_text(folder / "out" / "summary.json") == before);
    REQUIRE(run("new", more).status == kBadInput);
    REQUIRE_FALSE(testing::fs::exists(folder / "new"));
  }
  REQUIRE(run("new", {"--outcomes", (folder / "new" / "outcomes").string()}).status == kDone);
}

TEST_CASE("evaluate: the run of another mission is reported", "[apps]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(8);
  write_mission(folder / "m", mission);
  mission.name = "elsewhere";
  write_mission(folder / "other", mission);
  const std::string out = (folder / "out").string();
  REQUIRE(run_program({"replay", (folder / "m").string(), "-o", out, "--max-registrations", "1"}).status ==
          kDone);
  REQUIRE_THAT(run_program({"evaluate", out, (folder / "m").string()}).err, !Contains("another mission"));
  const ProgramRun other = run_program({"evaluate", out, (folder / "other").string()});
  REQUIRE(other.status == kDone);
  REQUIRE_THAT(other.err, Contains("another mission") && Contains("yard") && Contains("elsewhere"));
}

TEST_CASE("replay: closures without a truth are counted", "[apps]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(8);
  for (std::uint64_t i = 0; i < 8; ++i) mission.ground_truth.erase(make_key('a', i));
  write_mission(folder / "m", mission);
  const ProgramRun run =
      run_program({"replay", (folder / "m").string(), "-o", (folder / "out").string(), "--after-mission"});
  REQUIRE(run.status == kDone);
  REQUIRE_THAT(run.out, Contains("true inliers") && Contains(" of the verified ones have none"));
  REQUIRE_THAT(testing::read_text(folder / "out" / "summary.json"), Contains("\"without_truth\""));
}

TEST_CASE("command line: --strict refuses damaged scans", "[apps][error]") {
  const TemporaryFolder folder;
  write_mission(folder / "m", small_mission(4));
  const std::string mission = (folder / "m").string();
  const auto with = [&](const std::string& command) {
    return run_program({command, mission, "-o", (folder / ("of_" + command)).string(), "--strict"});
  };
  for (const char* command : {"convert", "replay"}) REQUIRE(with(command).status == kDone);
  const auto scan = testing::fs::directory_iterator(folder / "m" / "scans")->path();
  testing::write_text(scan, "");
  const auto refused = [](const ProgramRun& run) {
    REQUIRE(run.status == kBadInput);
    REQUIRE_THAT(run.err, Contains("scan is damaged"));
  };
  for (const char* command : {"convert", "replay"}) {
    CAPTURE(command);
    testing::fs::remove_all(folder / (std::string("of_") + command));
    refused(with(command));
  }
  // Only the map reads scans here.
  refused(run_program({"replay", mission, "-o", (folder / "o").string(), "--method", "odom", "--strict"}));
}

TEST_CASE("command line: options that would have no effect, and values out of bounds", "[apps][error]") {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases{
      {{"optimize", "g.g2o", "--inlier-probability", "0.9"}, "needs --gnc"},
      {{"optimize", "g.g2o", "--gnc", "--inlier-probability", "1"}, "0.999999"},
      {{"simulate", "tunnel", "-o", "x", "--robots", "0"}, "--robots"},
      {{"register", "a.pcd", "b.pcd", "--out", "c.xyz"}, ".pcd or .ply"},
      {{"replay", "m", "-o", "x", "--map-voxel", "0"}, "0 must be > 0"},
      {{"replay", "m", "-o", "x", "--clock", "real", "--rate", "inf"}, "inf must be > 0"},
      {{"evaluate", "a", "b", "--max-time-difference", "-1"}, "-1 must be >= 0"},
      {{"config", "--set", "gnc.inlier_probability=1"}, "(0, 0.999999]"}};
  for (const auto& [command, message] : cases) {
    CAPTURE(command);
    const ProgramRun run = run_program(command);
    REQUIRE(run.status == kBadUsage);
    REQUIRE_THAT(run.err, Contains(message));
  }
}

}  // namespace
}  // namespace loopwise::input_checks_test
