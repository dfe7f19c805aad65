// SPDX-License-Identifier: BSD-3-Clause
#include "run_errors.hpp"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "errors_json.hpp"

namespace loopwise {
namespace {

bool have_common_node(const PosesByKey& a, const PosesByKey& b) {
  return std::any_of(a.begin(), a.end(), [&](const auto& pose) { return b.count(pose.first) != 0; });
}

ClosureResiduals residuals_of(const std::vector<LoopClosure>& kept, const PosesByKey& poses) {
  std::vector<double> m, rad;
  for (const LoopClosure& closure : kept) {
    if (const auto off = closure_error(closure, poses)) {
      m.push_back(off->translation_m);
      rad.push_back(off->rotation_rad);
    }
  }
  return {statistics(m), statistics(rad)};
}

Json relative_json(const RelativeErrors& e) {
  return {{"translation_m", statistics_json(e.translation_m)},
          {"rotation_rad", statistics_json(e.rotation_rad)}};
}

Json residuals_json(const ClosureResiduals& residuals) {
  return {{"translation_m", statistics_json(residuals.translation_m)},
          {"rotation_rad", statistics_json(residuals.rotation_rad)}};
}

Json robots_json(const TrajectoryErrors& odometry, const TrajectoryErrors& optimized) {
  Json robots = Json::object();
  const auto put = [&robots](const char* which, const TrajectoryErrors& errors) {
    for (const RobotErrors& robot : errors.robots) {
      // A null must not become an object by indexing.
      if (!robots.contains(robot.name)) robots[robot.name] = Json::object();
      Json& entry = robots[robot.name];
      entry["poses"] = robot.poses;
      entry["path_length_m"] = robot.path_length_m;
      entry[which] = {{"ate_m", statistics_json(robot.ate_m)},
                      {"ate_rad", statistics_json(robot.ate_rad)},
                      {"translation_percent", robot.translation_percent},
                      {"rotation_deg_per_m", robot.rotation_deg_per_m}};
    }
  };
  put("odometry", odometry);
  put("optimized", optimized);
  return robots;
}

}  // namespace

void judge_poses(const Mission& mission, const PosesByKey& optimized, const PosesByKey& odometry,
                 const std::vector<LoopClosure>& kept, RunEvaluation& e) {
  e.residuals = residuals_of(kept, optimized);
  e.odometry_residuals = residuals_of(kept, odometry);
  const auto compared = [&mission](const PosesByKey& poses, const PosesByKey& with, Alignment alignment) {
    return evaluate_trajectory(poses, with, alignment, mission.robots);
  };
  e.has_reference = have_common_node(optimized, mission.reference);
  if (e.has_reference) {
    e.odometry_reference = compared(odometry, mission.reference, Alignment::kNone);
    e.optimized_reference = compared(optimized, mission.reference, Alignment::kNone);
  }
  const PosesByKey& truth = mission.ground_truth;
  e.has_truth = have_common_node(optimized, truth);
  if (!e.has_truth) return;
  const Alignment alignment = mission.truth_is_aligned ? Alignment::kSe3 : Alignment::kNone;
  e.odometry = compared(odometry, truth, alignment);
  e.optimized = compared(optimized, truth, alignment);
  e.odometry_aligned = compared(odometry, truth, Alignment::kSe3);
  e.optimized_aligned = compared(optimized, truth, Alignment::kSe3);
}

void put_errors(const Mission& mission, const RunEvaluation& e, Json& json) {
  json["closures"]["true_inliers"] = e.has_truth ? Json(e.closures.true_inliers) : Json(nullptr);
  json["closures"]["without_truth"] = e.has_truth ? Json(e.closures.without_truth) : Json(nullptr);
  json["residuals"] = nullptr;
  if (e.residuals.translation_m.count > 0) {
    json["residuals"] = {{"closures", e.residuals.translation_m.count},
                         {"odometry", residuals_json(e.odometry_residuals)},
                         {"optimized", residuals_json(e.residuals)}};
  }
  json["reference"] = nullptr;
  if (e.has_reference) {
    const auto differences = [](const Statistics& by_odometry, const Statistics& optimized) {
      return Json{{"odometry", by_odometry.mean}, {"optimized", optimized.mean}};
    };
    json["reference"] = {
        {"poses", e.optimized_reference.poses},
        {"difference_m", differences(e.odometry_reference.ate_m, e.optimized_reference.ate_m)},
        {"difference_rad", differences(e.odometry_reference.ate_rad, e.optimized_reference.ate_rad)}};
  }
  json["truth"] = nullptr;
  if (!e.has_truth) {
    for (const char* name : {"ate_m", "ate_rad", "ate_se3_m", "ate_rmse_m", "rpe"}) json[name] = nullptr;
    Json robots = Json::object();
    for (const Robot& robot : mission.robots.all()) robots[robot.name] = Json::object();
    json["robots"] = robots;
    return;
  }
  json["truth"] = {{"poses", e.optimized.poses}, {"alignment", enum_name(e.optimized.alignment)}};
  if (!mission.truth_file.empty()) json["truth"]["file"] = mission.truth_file;
  json["ate_m"] = {{"odometry", e.odometry.ate_m.mean}, {"optimized", e.optimized.ate_m.mean}};
  json["ate_rad"] = {{"odometry", e.odometry.ate_rad.mean}, {"optimized", e.optimized.ate_rad.mean}};
  json["ate_se3_m"] = {{"odometry", e.odometry_aligned.ate_m.mean},
                       {"optimized", e.optimized_aligned.ate_m.mean}};
  json["ate_rmse_m"] = {{"odometry", e.odometry.ate_m.rmse}, {"optimized", e.optimized.ate_m.rmse}};
  json["rpe"] = {{"odometry", relative_json(e.odometry.step)},
                 {"optimized", relative_json(e.optimized.step)}};
  json["robots"] = robots_json(e.odometry, e.optimized);
}

}  // namespace loopwise
