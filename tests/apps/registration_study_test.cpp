// SPDX-License-Identifier: BSD-3-Clause
// The study of registrars: its statistics, and the command as scripts see it.
#include <cmath>
#include <map>
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/io/mission.hpp>

#include "../../apps/loopwise/study_statistics.hpp"
#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise {
namespace {

using testing::run_program;
using testing::TemporaryFolder;

RegistrationResult accepted_at(const Eigen::Isometry3d& T_from_to, double sigma_m, double sigma_rad) {
  RegistrationResult result;
  result.reason = RejectionReason::kNone;
  result.T_from_to = T_from_to;
  LoopClosure closure;
  closure.T_from_to = T_from_to;
  closure.covariance.setZero();
  closure.covariance.diagonal() << Eigen::Vector3d::Constant(sigma_m * sigma_m),
      Eigen::Vector3d::Constant(sigma_rad * sigma_rad);
  result.closure = closure;
  return result;
}

TEST_CASE("judge: right, wrong within its own covariance, and false", "[apps][study]") {
  const Eigen::Isometry3d truth(Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()));
  const auto off = [&](double m, double rad) {
    return Eigen::Isometry3d(truth * Eigen::Translation3d(m, 0, 0) *
                             Eigen::AngleAxisd(rad, Eigen::Vector3d::UnitX()));
  };
  const cli::StudyOutcome right = cli::judge(accepted_at(off(0.3, 0.0), 0.1, 0.01), truth);
  REQUIRE(right.right());
  REQUIRE(right.error_m == Approx(0.3));
  REQUIRE(right.squared_mahalanobis == Approx(9.0));
  REQUIRE_FALSE(cli::judge(accepted_at(off(0.3, 0.06), 0.1, 0.01), truth).right());  // 3.4 degrees
  const cli::StudyOutcome admitted = cli::judge(accepted_at(off(2.0, 0.0), 1.0, 0.01), truth);
  REQUIRE_FALSE(admitted.right());
  REQUIRE_FALSE(admitted.false_accept());
  REQUIRE(cli::judge(accepted_at(off(2.0, 0.0), 0.1, 0.01), truth).false_accept());
  RegistrationResult refused;
  refused.reason = RejectionReason::kLowOverlap;
  REQUIRE_FALSE(cli::judge(refused, truth).accepted);
}

TEST_CASE("upper_bound_95: Clopper and Pearson's", "[apps][study]") {
  REQUIRE(cli::upper_bound_95(0, 100) == Approx(1.0 - std::pow(0.05, 0.01)).margin(1e-9));
  // P(at most 1 of 50) = (1−p)^50 + 50·p·(1−p)^49 = 0.05
  const double p = cli::upper_bound_95(1, 50);
  REQUIRE(std::pow(1 - p, 50) + 50 * p * std::pow(1 - p, 49) == Approx(0.05).margin(1e-9));
  REQUIRE(cli::upper_bound_95(7, 7) == 1.0);
  REQUIRE(cli::upper_bound_95(0, 0) == 1.0);
}

TEST_CASE("summarize: recall counts overlapping pairs, false accepts all", "[apps][study]") {
  std::vector<cli::StudyPair> pairs(4);
  pairs[0].overlap = pairs[1].overlap = 0.8;
  const Eigen::Isometry3d truth = Eigen::Isometry3d::Identity();
  const Eigen::Isometry3d far(Eigen::Translation3d(5, 0, 0));
  RegistrationResult refused;
  refused.reason = RejectionReason::kLowOverlap;
  std::vector<cli::StudyOutcome> outcomes{
      cli::judge(accepted_at(truth, 0.1, 0.01), truth), cli::judge(refused, truth),
      cli::judge(accepted_at(far, 0.1, 0.01), truth), cli::judge(accepted_at(truth, 0.1, 0.01), truth)};
  const cli::StudySummary s = cli::summarize(pairs, outcomes, {0, 1, 2, 3});
  REQUIRE(s.pairs == 4);
  REQUIRE(s.overlapping == 2);
  REQUIRE(s.recall == 0.5);
  REQUIRE(s.accepted == 3);
  REQUIRE(s.wrong == 1);
  REQUIRE(s.false_accepts == 1);
  REQUIRE(s.false_accept_bound == Approx(cli::upper_bound_95(1, 4)));
  REQUIRE(std::isnan(cli::summarize(pairs, outcomes, {2}).recall));
}

TEST_CASE("study registration: figures agree with the pairs, whatever the threads", "[apps][study]") {
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
}  // namespace loopwise
