// SPDX-License-Identifier: BSD-3-Clause
// The paper's Table II: each robot's errors by odometry, with closures at radio beacons alone, and with all.
#include <algorithm>
#include <map>
#include <optional>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>

#include "study.hpp"
#include "study_tables.hpp"
#include "study_units.hpp"

namespace loopwise::cli {
namespace {

constexpr double kDegrees = 57.29577951308232;

struct Options {
  StudyOptions study;
  std::vector<std::string> methods{"rssi", "full"};
  std::optional<std::int64_t> workers;
};

/// One robot in one run, or by odometry.
struct RobotFigures {
  double translation_percent = 0.0, max_m = 0.0, rotation_deg_per_m = 0.0, max_deg = 0.0;
};

RobotFigures figures_of(const Json& robot, const char* which) {
  return {figure(robot, {which, "translation_percent"}), figure(robot, {which, "ate_m", "max"}),
          figure(robot, {which, "rotation_deg_per_m"}), kDegrees * figure(robot, {which, "ate_rad", "max"})};
}

int run(Options options) {
  Console console(options.study.common.quiet);
  const InterruptGuard interrupt;
  options.methods = canonical_methods(options.methods);
  Study study("rssi", options.study, console);
  for (const StudyMission& mission : study.missions()) {
    if (!mission.has_radio) console.warn(mission.path + ": has no radio readings, so rssi finds nothing");
  }
  const std::vector<StudyUnit> units = units_by_method(study, options.methods, options.workers);
  const auto results = study.run(units, interrupt.token());
  if (!results) return study.status_without_results();

  std::vector<std::string> methods = options.methods;
  methods.erase(std::remove(methods.begin(), methods.end(), "odom"), methods.end());
  methods.insert(methods.begin(), "odom");
  const std::vector<std::string> names{"translation_percent", "max_m", "rotation_deg_per_m", "max_deg"};

  std::vector<std::string> header = run_columns();
  header.insert(header.end(), {"robot", "path_length_m"});
  header.insert(header.end(), names.begin(), names.end());
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
    // By robot and method: figures of all missions and seeds.
    std::map<std::string, std::map<std::string, std::vector<RobotFigures>>> by_robot;
    std::vector<std::string> order;
    const auto note = [&](const std::string& robot, const std::string& method, const RobotFigures& f) {
      if (by_robot.count(robot) == 0) order.push_back(robot);
      by_robot[robot][method].push_back(f);
    };
    for (std::size_t i = 0; i < units.size(); ++i) {
      const std::size_t m = units[i].mission;
      if (std::find(world.missions.begin(), world.missions.end(), m) == world.missions.end()) continue;
      const std::string method = to_string(units[i].config.replay.prioritization.method);
      const auto add = [&](const std::string& robot, const Json& of_robot, const std::string& as,
                           const char* which) {
        const RobotFigures f = figures_of(of_robot, which);
        note(robot, as, f);
        std::vector<std::string> row = run_cells(study, units[i], (*results)[i]);
        row[4] = as;
        row.insert(row.end(), {robot, number_text(figure(of_robot, {"path_length_m"})),
                               number_text(f.translation_percent), number_text(f.max_m),
                               number_text(f.rotation_deg_per_m), number_text(f.max_deg)});
        csv.row(row);
      };
      for (const auto& [robot, of_robot] : (*results)[i].summary.at("robots").items()) {
        if (method == options.methods.front()) add(robot, of_robot, "odom", "odometry");
        if (method != "odom") add(robot, of_robot, method, "optimized");
      }
    }
    Json of_world = {{"world", world.name},
                     {"missions", world.missions.size()},
                     {"parameters_sha256", world.parameters},
                     {"robots", Json::object()}};
    std::vector<std::vector<std::string>> rows{{"robot", ""}};
    for (const std::string& method : methods) rows.front().push_back(method);
    for (const std::string& robot : order) {
      std::vector<std::string> translation{robot, "transl."}, rotation{"", "rot."};
      for (const std::string& method : methods) {
        std::vector<std::vector<double>> values(names.size());
        for (const RobotFigures& f : by_robot[robot][method]) {
          values[0].push_back(f.translation_percent);
          values[1].push_back(f.max_m);
          values[2].push_back(f.rotation_deg_per_m);
          values[3].push_back(f.max_deg);
        }
        std::vector<double> medians;
        for (std::size_t k = 0; k < names.size(); ++k) {
          object_at(object_at(of_world["robots"], robot), method)[names[k]] = quartiles_json(values[k]);
          medians.push_back(quartiles(values[k]).median);
        }
        translation.push_back(fixed(medians[0], 3) + " (" + fixed(medians[1], 2) + ")");
        rotation.push_back(fixed(medians[2], 4) + " (" + fixed(medians[3], 2) + ")");
      }
      rows.push_back(translation);
      rows.push_back(rotation);
    }
    json["worlds"].push_back(of_world);
    text += "\n## " + describe(world) + "\n\n" + markdown_table(rows);
  }
  write_file(study.folder() / "robots.csv", csv.text());
  write_file(study.folder() / "rssi.json", json_text(json, 2) + "\n");
  write_file(study.folder() / "rssi.md", text);
  print_results(options.study.common, json, text);
  return kDone;
}

}  // namespace

void add_rssi_study(CLI::App& study, Action& chosen, Transport* job) {
  const auto options = std::make_shared<Options>();
  options->study.job = job;
  CLI::App* command = study.add_subcommand(
      "rssi", "Errors of each robot with closures at radio beacons: the paper's Table II");
  command->footer(
      "  loopwise study rssi finals-* -o rssi\n"
      "DIR gets robots.csv, rssi.json, rssi.md and rssi_timings.csv. Runs are kept as by 'study ablation', "
      "and shared\n"
      "with it if DIR is the same.");
  command->add_option("--methods", options->methods, "Methods beside odometry, by commas (default rssi,full)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("LIST");
  command
      ->add_option("--workers", options->workers,
                   "Registrations at a time on the mission's clock (default 10)")
      ->type_name("N");
  add_study_options(*command, options->study);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
