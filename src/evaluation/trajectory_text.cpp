// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/trajectory_text.hpp>

#include <limits>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_options.hpp>

#include "../core/constants.hpp"
#include "errors_json.hpp"

namespace loopwise {
namespace {

Json step_errors_json(const RelativeErrors& e) {
  return {{"count", e.translation_m.count},
          {"translation_m", statistics_json(e.translation_m)},
          {"rotation_rad", statistics_json(e.rotation_rad)},
          {"translation_percent", e.translation_percent},
          {"rotation_deg_per_m", e.rotation_deg_per_m}};
}

Json robot_json(const RobotErrors& robot) {
  return {{"poses", robot.poses},
          {"path_length_m", robot.path_length_m},
          {"ate_m", statistics_json(robot.ate_m)},
          {"ate_rad", statistics_json(robot.ate_rad)},
          {"rpe", step_errors_json(robot.step)},
          {"translation_percent", robot.translation_percent},
          {"rotation_deg_per_m", robot.rotation_deg_per_m}};
}

std::vector<std::string> row(const RobotErrors& e) {
  return {e.name,
          std::to_string(e.poses),
          fixed(e.path_length_m, 1),
          fixed(e.ate_m.mean, 3),
          fixed(e.ate_m.max, 3),
          fixed(e.ate_rad.mean * kDegreesPerRadian, 3),
          fixed(e.ate_rad.max * kDegreesPerRadian, 3),
          fixed(e.translation_percent, 2),
          fixed(e.rotation_deg_per_m, 3)};
}

}  // namespace

std::string trajectory_errors_json(const TrajectoryErrors& errors) {
  Json distances = Json::array();
  for (const RelativeErrors& e : errors.by_distance) {
    distances.push_back(step_errors_json(e));
    distances.back()["distance_m"] = e.distance_m;
  }
  Json robots = Json::object();
  for (const RobotErrors& robot : errors.robots) robots[robot.name] = robot_json(robot);
  return json_text({{"poses", errors.poses},
                    {"alignment", enum_name(errors.alignment)},
                    {"ate_m", statistics_json(errors.ate_m)},
                    {"ate_rad", statistics_json(errors.ate_rad)},
                    {"rpe", step_errors_json(errors.step)},
                    {"rpe_by_distance", distances},
                    {"robots", robots}});
}

std::string trajectory_errors_table(const TrajectoryErrors& errors) {
  std::vector<std::vector<std::string>> rows{{"robot", "poses", "length m", "ATE mean m", "max m", "mean deg",
                                              "max deg", "transl. %", "rot. deg/m"}};
  RobotErrors all;  // its errors in relation to the path are unknown
  all.name = "all";
  all.poses = errors.poses;
  all.ate_m = errors.ate_m;
  all.ate_rad = errors.ate_rad;
  for (const RobotErrors& robot : errors.robots) {
    rows.push_back(row(robot));
    all.path_length_m += robot.path_length_m;
  }
  rows.push_back(row(all));
  return table(rows);
}

}  // namespace loopwise
