// SPDX-License-Identifier: BSD-3-Clause
// The study of registrars: the command as scripts see it.
#include <cmath>
#include <map>
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/io/mission.hpp>

#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::registration_study_test {
namespace {

using testing::run_program;
using testing::TemporaryFolder;

TEST_CASE("study registration: figures agree with the pairs, for any number of threads", "[apps][study]") {
  const TemporaryFolder folder;
  const std::string mission = (folder / "mission").string(), csv = (folder / "pairs.csv").string();
  write_mission(mission, testing::small_mission());
  const auto study = [&](const std::string& threads, const std::string& seed) {
    return run_program({"study", "registration", mission, "--registrar", "fast", "--count", "40", "--csv",
                        csv, "--threads", threads, "--seed", seed, "--json", "-"});
  };
  const auto run = study("1", "1");
  CAPTURE(run.err);
  REQUIRE(run.status == 0);
  const auto json = nlohmann::json::parse(run.out);
  const auto& fast = json.at("registrars").at("fast");
  REQUIRE(json.at("sampled") == 40);
  REQUIRE(fast.at("pairs") == 40);
  REQUIRE(fast.at("false_accepts") == 0);
  REQUIRE(fast.at("error").at("median_m").get<double>() <
          0.2);  // measured 0.12: scans of 1200 points to 40 m

  const auto without_times = [&] {
    std::istringstream lines(testing::read_text(csv));
    std::vector<std::string> rows;
    for (std::string line; std::getline(lines, line);) {
      for (int column = 0; column < 3; ++column) line.erase(line.rfind(','));
      rows.push_back(line);
    }
    return rows;
  };
  const auto rows = without_times();
  REQUIRE(rows.size() == 41);
  std::size_t accepted = 0, rejected = 0, overlapping = 0, recalled = 0;
  for (std::size_t i = 1; i < rows.size(); ++i) {
    std::istringstream line(rows[i]);
    std::vector<std::string> cells;
    for (std::string cell; std::getline(line, cell, ',');) cells.push_back(cell);
    const bool overlaps = std::stod(cells.at(4)) >= 0.4, verified = cells.at(6).empty();
    ++(verified ? accepted : rejected);
    overlapping += overlaps ? 1 : 0;
    recalled +=
        overlaps && verified && std::stod(cells.at(7)) <= 0.5 && std::stod(cells.at(8)) <= 0.0524 ? 1 : 0;
  }
  REQUIRE(fast.at("overlapping") == overlapping);
  REQUIRE(fast.at("recalled") == recalled);
  REQUIRE(recalled >= 4);  // measured 8 of 22: most overlap by little more than 0.4
  REQUIRE(fast.at("accepted") == accepted);
  std::size_t reasons = 0;
  for (const auto& [name, count] : fast.at("rejected").items()) reasons += count.get<std::size_t>();
  REQUIRE(reasons == rejected);
  std::map<std::string, std::size_t> by_property;
  for (const auto& stratum : fast.at("strata")) {
    by_property[stratum.at("property")] += stratum.at("pairs").get<std::size_t>();
  }
  REQUIRE(by_property ==
          std::map<std::string, std::size_t>{{"distance_m", 40}, {"observability", 40}, {"overlap", 40}});

  REQUIRE(study("2", "1").status == 0);
  REQUIRE(without_times() == rows);
  REQUIRE(study("2", "2").status == 0);
  REQUIRE(without_times() != rows);  // another draw
}

TEST_CASE("study registration: bad input", "[apps][study][error]") {
  const TemporaryFolder folder;
  Mission mission = testing::small_mission(3);
  mission.ground_truth.clear();
  const std::string path = (folder / "mission").string();
  write_mission(path, mission);
  const auto run = run_program({"study", "registration", path});
  REQUIRE(run.status == 3);
  REQUIRE(run.err.find("has no ground truth") != std::string::npos);
  REQUIRE(run_program({"study", "registration", path, "--registrar", "slow"}).status == 2);
  REQUIRE(run_program({"study", "registration", (folder / "none").string()}).status == 3);
}

}  // namespace
}  // namespace loopwise::registration_study_test
