// SPDX-License-Identifier: BSD-3-Clause
// The paper's Table II: each robot's errors by odometry, with closures at radio beacons only, and with all.
#include <algorithm>
#include <map>
#include <optional>

#include <nlohmann/json.hpp>

#include <loopwise/io/csv.hpp>
#include <loopwise/study/study.hpp>

#include "scheduler.hpp"
#include "tables.hpp"

namespace loopwise::study {
namespace {

constexpr double kDegrees = 57.29577951308232;

/// One robot in one run, or by odometry.
struct RobotFigures {
  double translation_percent = 0.0, max_m = 0.0, rotation_deg_per_m = 0.0, max_deg = 0.0;
};

RobotFigures figures_of(const Json& robot, const char* which) {
  return {figure(robot, {which, "translation_percent"}), figure(robot, {which, "ate_m", "max"}),
          figure(robot, {which, "rotation_deg_per_m"}), kDegrees * figure(robot, {which, "ate_rad", "max"})};
}

const std::vector<std::string> kFigures{"translation_percent", "max_m", "rotation_deg_per_m", "max_deg"};

/// Figures of a world's missions and seeds by robot and method; robots in the order of their appearance.
struct RobotTable {
  std::map<std::string, std::map<std::string, std::vector<RobotFigures>>> figures;
  std::vector<std::string> robots;

  void add(const std::string& robot, const std::string& method, const RobotFigures& of) {
    if (figures.count(robot) == 0) robots.push_back(robot);
    figures[robot][method].push_back(of);
  }
};

/// The runs of a world's missions; each gets its rows in the CSV. Odometry is noted once for each run of
/// the method `first`.
RobotTable collect(const Study& study, const World& world, const std::vector<StudyUnit>& units,
                   const std::vector<UnitResult>& results, const std::string& first, CsvText& csv) {
  RobotTable table;
  for (std::size_t i = 0; i < units.size(); ++i) {
    const std::size_t m = units[i].mission;
    if (std::find(world.missions.begin(), world.missions.end(), m) == world.missions.end()) continue;
    const std::string method = to_string(units[i].config.replay.prioritization.method);
    const auto add = [&](const std::string& robot, const Json& of_robot, const std::string& as,
                         const char* which) {
      const RobotFigures f = figures_of(of_robot, which);
      table.add(robot, as, f);
      std::vector<std::string> row = run_cells(study, units[i], results[i]);
      row[4] = as;
      row.insert(row.end(),
                 {robot, number_text(figure(of_robot, {"path_length_m"})), number_text(f.translation_percent),
                  number_text(f.max_m), number_text(f.rotation_deg_per_m), number_text(f.max_deg)});
      csv.row(row);
    };
    for (const auto& [robot, of_robot] : results[i].summary.at("robots").items()) {
      if (method == first) add(robot, of_robot, "odom", "odometry");
      if (method != "odom") add(robot, of_robot, method, "optimized");
    }
  }
  return table;
}

/// Two rows for each robot, and its medians in the JSON.
std::vector<std::vector<std::string>> robot_rows(RobotTable& table, const std::vector<std::string>& methods,
                                                 Json& of_world) {
  std::vector<std::vector<std::string>> rows{{"robot", ""}};
  for (const std::string& method : methods) rows.front().push_back(method);
  for (const std::string& robot : table.robots) {
    std::vector<std::string> translation{robot, "transl."}, rotation{"", "rot."};
    for (const std::string& method : methods) {
      std::vector<std::vector<double>> values(kFigures.size());
      for (const RobotFigures& f : table.figures[robot][method]) {
        values[0].push_back(f.translation_percent);
        values[1].push_back(f.max_m);
        values[2].push_back(f.rotation_deg_per_m);
        values[3].push_back(f.max_deg);
      }
      std::vector<double> medians;
      for (std::size_t k = 0; k < kFigures.size(); ++k) {
        object_at(object_at(of_world["robots"], robot), method)[kFigures[k]] = quartiles_json(values[k]);
        medians.push_back(quartiles(values[k]).median);
      }
      translation.push_back(fixed(medians[0], 3) + " (" + fixed(medians[1], 2) + ")");
      rotation.push_back(fixed(medians[2], 4) + " (" + fixed(medians[3], 2) + ")");
    }
    rows.push_back(translation);
    rows.push_back(rotation);
  }
  return rows;
}

}  // namespace

std::optional<StudyReport> rssi(const StudyOptions& options, const RssiOptions& wanted,
                                const StudyHooks& hooks) {
  const std::vector<std::string> asked = canonical_methods(wanted.methods);
  Study study("rssi", options, hooks);
  for (const StudyMission& mission : study.missions()) {
    if (!mission.has_radio)
      study.warn(mission.source.path + ": has no radio readings, so rssi finds nothing");
  }
  const std::vector<StudyUnit> units = units_by_method(study, asked, wanted.workers);
  const auto results = study.run(units);
  if (!results) return std::nullopt;

  std::vector<std::string> methods = asked;
  methods.erase(std::remove(methods.begin(), methods.end(), "odom"), methods.end());
  methods.insert(methods.begin(), "odom");
  std::vector<std::string> header = run_columns();
  header.insert(header.end(), {"robot", "path_length_m"});
  header.insert(header.end(), kFigures.begin(), kFigures.end());
  CsvText csv(header);

  Json json = study_json(study);
  json["options"] = parse_json(config_json(units.front().config), "options");
  json["methods"] = methods;
  json["worlds"] = Json::array();
  std::string text =
      "# Errors of each robot\n\n" + budget_text(units.front().config) +
      " Translation: mean error in % of the path so far, in brackets the largest in m; rotation: mean "
      "error in ° per m of the path, in brackets the largest in °. Positions and rotations are compared " +
      frame_text(study.missions()) + ". Medians over missions and seeds.\n";
  for (const World& world : worlds_of(study.missions())) {
    RobotTable table = collect(study, world, units, *results, asked.front(), csv);
    Json of_world = {{"world", world.name},
                     {"missions", world.missions.size()},
                     {"parameters_sha256", world.parameters},
                     {"robots", Json::object()}};
    const auto rows = robot_rows(table, methods, of_world);
    json["worlds"].push_back(of_world);
    text += "\n## " + describe(world) + "\n\n" + markdown_table(rows);
  }
  return StudyReport{json_text(json, 2) + "\n", text, csv.text()};
}

}  // namespace loopwise::study
