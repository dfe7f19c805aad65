// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/io/json_options.hpp>

#include "program.hpp"

namespace loopwise::report_command_test {

TEST_CASE("loopwise report: a page of a run, or an error", "[apps][report]") {
  using testing::run_program;
  const testing::TemporaryFolder folder;
  const std::string mission = LOOPWISE_SOURCE_DIR "/data/sample_mission", run = (folder / "run").string(),
                    page = (folder / "report.html").string();
  REQUIRE(run_program({"replay", mission, "-o", run, "--max-registrations", "20", "--quiet"}).status == 0);

  const testing::ProgramRun made =
      run_program({"report", run, "-o", page, "--mission", mission, "--json", "-", "--threads", "1"});
  if (made.err.find("cannot write reports") != std::string::npos) {
    REQUIRE(made.status == 1);
    REQUIRE(Contains("LOOPWISE_WITH_REPORT").match(made.err));
    REQUIRE_FALSE(testing::fs::exists(page));
    return;
  }
  REQUIRE(made.status == 0);
  const Json json = parse_json(made.out, "standard output");
  REQUIRE(json.at("report") == page);
  REQUIRE(json.at("bytes") == testing::fs::file_size(page));
  REQUIRE(json.at("runs") == 1);
  REQUIRE(json.at("maps") == 1);
  REQUIRE(json.at("studies") == 0);
  REQUIRE(json.at("notes") == Json::array());
  const std::string text = testing::read_text(page);
  REQUIRE(text.rfind("<!doctype html>", 0) == 0);
  REQUIRE(Contains("\"mission\":\"tunnel-13\"").match(text));
  REQUIRE(text.size() < 25000000);

  // The same bytes again, on other threads.
  REQUIRE(run_program({"report", run, "-o", page, "--mission", mission, "--threads", "3"}).status == 0);
  REQUIRE(testing::read_text(page) == text);

  REQUIRE(run_program({"report"}).status == 2);
  REQUIRE(run_program({"report", run, "-o", page, "--map-points", "-1"}).status == 2);
  REQUIRE(run_program({"report", (folder / "absent").string(), "-o", page}).status == 3);
  REQUIRE(run_program({"report", mission, "-o", page}).status == 3);
  REQUIRE(run_program({"report", run, "-o", page, "--mission", (folder / "absent").string()}).status == 3);
  REQUIRE(run_program({"report", run, "-o", (folder / "absent" / "r.html").string()}).status == 3);
  REQUIRE(testing::read_text(page) == text);
}

}  // namespace loopwise::report_command_test
