// SPDX-License-Identifier: BSD-3-Clause
#include "simulation_text.hpp"

#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/simulation/statistics.hpp>

#include "mission_text.hpp"
#include "units.hpp"

namespace loopwise::cli {
namespace {

Json quartiles(const ScoreQuartiles& q) {
  return {{"count", q.count},
          {"low", number_or_null(q.low)},
          {"median", number_or_null(q.median)},
          {"high", number_or_null(q.high)}};
}

}  // namespace

double add_robots(const Mission& mission, Json& json, std::string& text) {
  Json robots = Json::array();
  std::vector<std::vector<std::string>> rows{{"robot", "length m", "drift m", "drift %", "drift deg"}};
  double length = 0.0;
  for (const RobotDrift& drift : odometry_drift(mission)) {
    length += drift.length_m;
    robots.push_back({{"name", drift.robot},
                      {"length_m", drift.length_m},
                      {"largest_error_m", drift.largest_m},
                      {"largest_error_rad", drift.largest_rad},
                      {"end_error_m", drift.end_m}});
    rows.push_back({drift.robot, fixed(drift.length_m, 1), fixed(drift.largest_m, 2),
                    fixed(100.0 * drift.largest_m / drift.length_m, 2),
                    fixed(drift.largest_rad * kDegreesPerRadian, 2)});
  }
  json["robots"] = robots;
  text += table(rows);
  return length;
}

void add_statistics(const SimulatedMission& made, int threads, Json& json, std::string& text) {
  CandidateStatisticsOptions candidate_options;
  candidate_options.threads = threads;
  add_candidates(made.mission, candidate_options, json, text);
  const SensorStatistics sensors = sensor_statistics(made, threads);
  json["observability"] = {{"corridors", quartiles(sensors.corridors)},
                           {"elsewhere", quartiles(sensors.elsewhere)}};
  text += "observable   corridors " + fixed(sensors.corridors.median, 3) + ", elsewhere " +
          fixed(sensors.elsewhere.median, 3) + " (medians)\n";
  std::vector<std::vector<std::string>> rows{
      {"beacon at m", "walls", "heard", "missed", "mean dBm", "sigma dB"}};
  Json power = Json::array();
  for (const PowerBin& bin : sensors.power) {
    power.push_back({{"from_m", bin.from_m},
                     {"to_m", bin.to_m},
                     {"walls", bin.walls},
                     {"heard", bin.heard},
                     {"missed", bin.missed},
                     {"mean_dbm", number_or_null(bin.mean_dbm)},
                     {"sigma_db", number_or_null(bin.sigma_db)}});
    if (bin.heard + bin.missed == 0) continue;
    rows.push_back({fixed(bin.from_m, 0) + "-" + fixed(bin.to_m, 0), bin.walls ? "yes" : "no",
                    std::to_string(bin.heard), std::to_string(bin.missed), fixed(bin.mean_dbm, 1),
                    fixed(bin.sigma_db, 1)});
  }
  json["power"] = power;
  if (rows.size() > 1) text += "\n" + table(rows);
}

}  // namespace loopwise::cli
