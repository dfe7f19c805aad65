// SPDX-License-Identifier: BSD-3-Clause
// Maps: written, and judged without a truth.
#include <string>
#include <vector>

#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>

#include "program.hpp"
#include "small_mission.hpp"

namespace loopwise {
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

}  // namespace
}  // namespace loopwise
