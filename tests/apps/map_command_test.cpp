// SPDX-License-Identifier: BSD-3-Clause
// Maps: written, and judged without a truth.
#include <algorithm>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/io/cloud.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

#include "evaluation/yard.hpp"
#include "program.hpp"
#include "small_mission.hpp"

namespace loopwise::map_command_test {
namespace {

using Catch::Matchers::Contains;
using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;

TEST_CASE("replay: a run without closures prints the reason and a remedy", "[apps]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(4));
  const std::vector<std::string> replay = {
      "replay", (folder / "mission").string(), "--overwrite", "-o", (folder / "out").string(),
      "--set",  "generation.skip_recent=1"};
  const auto with = [&](const std::string& option) {
    std::vector<std::string> arguments = replay;
    arguments.insert(arguments.end(), {"--set", option});
    const ProgramRun run = run_program(arguments);
    REQUIRE(run.status == 0);
    return run.out;
  };
  REQUIRE_THAT(with("fast_registrar.min_overlap=1"),
               Contains("no closure   of ") && Contains("failed by low_overlap: "));
  REQUIRE_THAT(with("fast_registrar.min_points=100000"),
               Contains("no closure   of ") && Contains("--submap 10"));
  REQUIRE_THAT(with("generation.skip_recent=1"), !Contains("no closure"));
}

TEST_CASE("replay: the map as PLY holds the points of the PCD", "[apps]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(4));
  const testing::fs::path out = folder / "out";
  REQUIRE(run_program({"replay", (folder / "mission").string(), "-o", out.string(), "--map-ply"}).status ==
          0);
  REQUIRE(read_cloud(out / "map.ply").cloud.points == read_cloud(out / "map.pcd").cloud.points);
  REQUIRE(run_program({"replay", (folder / "mission").string(), "-o", out.string(), "--overwrite"}).status ==
          0);
  REQUIRE(!testing::fs::exists(out / "map.ply"));
}

Json summary_of(const testing::fs::path& run) {
  return parse_json(testing::read_text(run / "summary.json"), "summary.json");
}

TEST_CASE("evaluate --map: a run keeps its figures for the report", "[apps][map]") {
  const TemporaryFolder folder;
  const std::string mission = LOOPWISE_SOURCE_DIR "/data/sample_mission", out = (folder / "out").string();
  const std::vector<std::string> replay = {
      "replay", mission, "-o", out, "--overwrite", "--max-registrations", "10", "--quiet"};
  REQUIRE(run_program(replay).status == 0);
  REQUIRE(!summary_of(out).contains("map_quality"));
  const std::string json = (folder / "quality.json").string();
  const ProgramRun run = run_program({"evaluate", "--map", out, mission, "--json", json});
  INFO(run.err);
  REQUIRE(run.status == 0);
  const Json quality = parse_json(testing::read_text(json), json);
  CHECK(quality["not_meaningful"].is_null());
  CHECK(quality["coverage"].get<double>() > 0.5);
  CHECK(quality["planes"].get<int>() > 100);
  const Json& thickness = quality["thickness_m"];
  CHECK(thickness["registered"].get<double>() <= thickness["estimate"].get<double>());
  CHECK(quality["difference_interval_95"][0].is_number());
  CHECK(summary_of(out)["map_quality"] == quality);
  CHECK_THAT(run.err, Contains("kept as map_quality"));
  CHECK_THAT(run.out, Contains("thickness ") && Contains(" planes)") && Contains(" % of the path"));
  const std::string page = (folder / "report.html").string();
  const ProgramRun report = run_program({"report", out, "-o", page, "--quiet"});
  if (report.status == 0) CHECK_THAT(testing::read_text(page), Contains("\"map_quality\":{"));

  // Not that of another recording of the same keys.
  Mission other = read_mission(mission);
  other.name = "another";
  write_mission(folder / "another", other);
  const Json before = summary_of(out);
  const ProgramRun foreign = run_program({"evaluate", "--map", out, (folder / "another").string()});
  CHECK(foreign.status == 0);
  CHECK_THAT(foreign.err,
             Contains("the quality is not added, because the run is of the mission \"tunnel-13\""));
  CHECK(summary_of(out) == before);

  // And a new run has none.
  REQUIRE(run_program(replay).status == 0);
  CHECK(!summary_of(out).contains("map_quality"));
}

TEST_CASE("evaluate --map: without revisits nothing is meaningful", "[apps][map]") {
  const TemporaryFolder folder;
  const std::string mission = (folder / "mission").string(), out = (folder / "out").string();
  write_mission(mission, small_mission(4));
  REQUIRE(run_program({"replay", mission, "-o", out, "--method", "odom", "--quiet"}).status == 0);
  const ProgramRun run = run_program({"evaluate", "--map", out, mission});
  INFO(run.err);
  CHECK(run.status == 0);
  CHECK_THAT(run.out, Contains("not meaningful: of 0 pairs of nodes") && !Contains("nan"));
  const Json quality = summary_of(out)["map_quality"];
  CHECK(quality["revisits"] == 0);
  CHECK_THAT(quality["not_meaningful"].get<std::string>(), Contains("no registration proves one"));
  CHECK(quality["displacement_m"]["estimate"]["mean"].is_null());
  CHECK_THAT(run.err, !Contains("noise"));

  REQUIRE(run_program({"replay", mission, "-o", out, "--method", "odom", "--odometry-noise", "0.01", "0.001",
                       "--overwrite", "--quiet"})
              .status == 0);
  CHECK_THAT(run_program({"evaluate", "--map", out, mission}).err, Contains("the run added noise"));
}

TEST_CASE("evaluate --map: a session in a wrong frame is noticed beside others in right ones",
          "[apps][map]") {
  const TemporaryFolder folder;
  std::vector<std::string> sessions;
  for (const char robot : {'a', 'b', 'c'}) {
    sessions.push_back((folder / std::string(1, robot)).string());
    write_mission(sessions.back(), testing::yard({robot}));
  }
  const auto joined = [&](const std::string& name, double x_m) {
    const testing::fs::path frames = folder / (name + ".txt");
    testing::write_text(frames,
                        "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n2 " + std::to_string(x_m) + " 0 0 0 0 0 1\n");
    std::vector<std::string> words{"convert", "-o", (folder / name).string(), "--frames", frames.string()};
    words.insert(words.end(), sessions.begin(), sessions.end());
    const ProgramRun run = run_program(words);
    INFO(run.err);
    REQUIRE(run.status == 0);
    return (folder / name).string();
  };
  const std::string right = joined("right", 0.0), wrong = joined("wrong", 16.0);
  const auto said = [](const std::string& estimate, const std::string& recording) {
    const ProgramRun run = run_program({"evaluate", "--map", estimate, recording});
    CAPTURE(run.out);
    CHECK(run.status == 0);
    return run.err;
  };
  CHECK_THAT(said(wrong, right), Contains("the frames of the robots may be wrong"));
  CHECK_THAT(said(right, wrong), !Contains("may be wrong"));
}

TEST_CASE("study ablation --map-quality: maps are judged beside the errors", "[apps][study][map]") {
  const TemporaryFolder folder;
  const std::string mission = (folder / "m").string();
  write_mission(mission, small_mission(12));
  const auto study = [&](const std::vector<std::string>& more) {
    std::vector<std::string> words{
        "study",   "ablation", mission,         "-o", (folder / "out").string(), "--methods", "random",
        "--batch", "5",        "--skip-recent", "2",  "--max-registrations",     "8"};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramRun run = run_program(words);
    INFO(run.err);
    REQUIRE(run.status == 0);
    return run;
  };
  REQUIRE_THAT(study({}).out, !Contains("displacement"));
  // A run that was kept without being judged, and one that was judged without being kept, do not make up for
  // one that is both.
  study({"--keep-runs"});
  study({"--map-quality"});
  const ProgramRun judged = study({"--map-quality", "--keep-runs"});
  REQUIRE_THAT(judged.err, !Contains("finished already"));
  REQUIRE_THAT(judged.out, Contains("| displacement there, m |") &&
                               Contains("| thickness of surfaces there, m |") &&
                               Contains("Not meaningful for 1 of 1 run"));  // 24 m are two stretches
  REQUIRE_THAT(study({"--map-quality", "--keep-runs"}).err, Contains("1 of 1 runs are finished already"));
  std::ifstream file(folder / "out" / "runs.csv");
  std::string header;
  std::getline(file, header);
  std::vector<std::string> names;
  std::istringstream words(header);
  for (std::string name; std::getline(words, name, ',');) names.push_back(name);
  const CsvTable rows(folder / "out" / "runs.csv", names);
  REQUIRE(rows.size() == 1);
  const auto value = [&](const char* name) {
    return rows.number(0,
                       static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin()));
  };
  CHECK(value("map_revisits") > 0.0);
  CHECK(value("map_coverage") > 50.0);
  CHECK(value("odometry_map_displacement_m") > 0.0);
  const Json json = parse_json(testing::read_text(folder / "out" / "ablation.json"), "ablation.json");
  for (const char* method : {"odom", "random"}) {
    CAPTURE(method);
    CHECK(json["worlds"][0]["methods"][method]["map_displacement_m"]["median"].is_number());
  }
  // The folder of the run says the same as `evaluate --map` of it.
  const testing::fs::path run = testing::fs::directory_iterator(folder / "out" / "runs")->path();
  const Json kept = summary_of(run)["map_quality"];
  CHECK(kept["displacement_m"]["estimate"]["mean"] == Approx(value("map_displacement_m")));
  const ProgramRun evaluated = run_program({"evaluate", "--map", run.string(), mission, "--json", "-"});
  CHECK(parse_json(evaluated.out, "standard output")["revisits"] == kept["revisits"]);
}

}  // namespace
}  // namespace loopwise::map_command_test
