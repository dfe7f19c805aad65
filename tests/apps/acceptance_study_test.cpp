// SPDX-License-Identifier: BSD-3-Clause
// Chances of method expected: fitted to missions, and given to a replay.
#include <nlohmann/json.hpp>

#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::acceptance_study_test {
namespace {

using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;

}  // namespace

TEST_CASE("study acceptance: models that cannot be fitted are left out with a reason", "[apps][study]") {
  const TemporaryFolder folder;
  write_mission(folder / "one", small_mission(8, 9));
  write_mission(folder / "two", small_mission(10, 9));
  const std::string chances = (folder / "chances.json").string(), report = (folder / "report.json").string();
  // Every verified closure is kept here, so there is no data on closures that the back end rejects.
  const ProgramRun run =
      run_program({"study", "acceptance", (folder / "one").string(), (folder / "two").string(), "-o", chances,
                   "--json", report, "--skip-recent", "2", "--set", "replay.after_mission=true"});
  INFO(run.out + run.err);
  REQUIRE(run.status == 0);
  const Json fitted = parse_json(testing::read_text(report), report);
  REQUIRE(fitted["verified_weights"]["weights"].size() == 6);
  REQUIRE(fitted["right_weights"]["weights"].is_null());
  CHECK_THAT(fitted["right_weights"]["reason"].get<std::string>(), Contains("all came to the same"));
  CHECK_THAT(run.out, Contains("Not fitted: ") && Contains("--set expected.verified_weights="));
  CHECK_THAT(run.err, Contains("right_weights not fitted"));
  const Json kept = parse_json(testing::read_text(chances), chances);
  REQUIRE(kept["expected"].contains("verified_weights"));
  REQUIRE_FALSE(kept["expected"].contains("right_weights"));
}

TEST_CASE("replay: unreadable weights leave earlier results unchanged", "[apps][replay][error]") {
  const TemporaryFolder folder;
  write_mission(folder / "m", small_mission(8));
  const std::string mission = (folder / "m").string(), out = (folder / "out").string();
  const std::vector<std::string> replay{
      "replay", mission, "-o", out, "--overwrite", "--skip-recent", "2", "--max-registrations", "2"};
  REQUIRE(run_program(replay).status == 0);
  const std::string before = testing::read_text(folder / "out" / "summary.json");
  std::vector<std::string> wrong = replay;
  wrong.insert(wrong.end(), {"--set", "expected.right_weights=1,2"});
  const ProgramRun run = run_program(wrong);
  CHECK(run.status == 2);
  CHECK_THAT(run.err, Contains("expected.right_weights: 2 numbers, 6 are needed"));
  REQUIRE(testing::read_text(folder / "out" / "summary.json") == before);
}

}  // namespace loopwise::acceptance_study_test
