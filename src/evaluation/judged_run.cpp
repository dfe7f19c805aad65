// SPDX-License-Identifier: BSD-3-Clause
#include "judged_run.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>

#include "report_parts.hpp"
#include "report_paths.hpp"
#include "run_errors.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

/// A closure of closures.csv.
struct VerifiedClosure {
  LoopClosure closure;
  double weight = 0.0;
};

/// Empty if the file is missing or lacks a column.
std::optional<std::vector<VerifiedClosure>> read_verified(const fs::path& file) {
  if (!fs::exists(file)) return std::nullopt;
  const std::vector<std::string> names = csv_header(file);
  const CsvTable table(file, names);
  std::vector<std::size_t> columns;
  for (const char* name : {"outcome", "from", "to", "weight", "x", "y", "z", "qx", "qy", "qz", "qw"}) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) return std::nullopt;
    columns.push_back(static_cast<std::size_t>(found - names.begin()));
  }
  std::vector<VerifiedClosure> closures;
  for (std::size_t r = 0; r < table.size(); ++r) {
    if (table.text(r, columns[0]) != "verified") continue;
    const auto number = [&](std::size_t c) { return table.number(r, columns[c]); };
    VerifiedClosure one;
    one.closure.from = table.key(r, columns[1]);
    one.closure.to = table.key(r, columns[2]);
    one.weight = table.number_or_nan(r, columns[3]);
    one.closure.T_from_to.translation() << number(4), number(5), number(6);
    one.closure.T_from_to.linear() =
        Eigen::Quaterniond(number(10), number(7), number(8), number(9)).normalized().toRotationMatrix();
    closures.push_back(one);
  }
  return closures;
}

bool is_null_at(const Json& summary, const char* name) {
  return !summary.contains(name) || summary[name].is_null();
}

/// Whether a reader of sessions noted the problem, and no other reader.
bool is_of_session(const Json& summary) {
  if (!summary.contains("problems") || !summary["problems"].is_array()) return false;
  return std::any_of(summary["problems"].begin(), summary["problems"].end(), [](const Json& problem) {
    return problem.is_string() &&
           problem.get<std::string>().find(": the first node gets one") != std::string::npos;
  });
}

/// From the folder's files. Empty if one is missing.
std::optional<RunEvaluation> evaluate_folder(const fs::path& folder, const Mission& mission) {
  const auto closures = read_verified(folder / "closures.csv");
  if (!closures || !fs::exists(folder / "graph.g2o")) return std::nullopt;
  const PoseGraph graph = read_g2o(folder / "graph.g2o").graph;
  const PosesByKey optimized = poses_by_key(graph);
  PosesByKey odometry;
  for (const RobotPath& robot : robot_paths(folder, graph)) {
    for (std::size_t i = 0; i < robot.odometry.size(); ++i) odometry[robot.keys[i]] = robot.odometry[i];
  }
  for (const auto& [key, pose] : optimized) {
    if (odometry.count(key) == 0 && !mission.robots.is_landmark(key)) return std::nullopt;
    if (!mission.robots.find(key)) return std::nullopt;
  }
  RunEvaluation evaluation;
  const ClosureClassOptions classes;
  std::vector<LoopClosure> kept;
  for (const VerifiedClosure& one : *closures) {
    if (one.weight > classes.gnc_inlier_weight) kept.push_back(one.closure);
    const auto error = closure_error(one.closure, mission.ground_truth);
    const bool is_true = error && error->translation_m <= classes.true_inlier_m &&
                         error->rotation_rad <= classes.true_inlier_rad;
    evaluation.closures.true_inliers += is_true ? 1 : 0;
    evaluation.closures.without_truth += error ? 0 : 1;
  }
  judge_poses(mission, optimized, odometry, kept, evaluation);
  return evaluation;
}

/// Whether two summaries have the same errors, up to the digits that the run's files store.
bool is_judged_alike(const Json& a, const Json& b) {
  const auto number = [](const Json& summary, const char* section,
                         const char* name) -> std::optional<double> {
    if (is_null_at(summary, section) || !summary[section].is_object()) return std::nullopt;
    const Json value = summary[section].value(name, Json());
    return value.is_number() ? std::optional(value.get<double>()) : std::nullopt;
  };
  const auto alignment = [](const Json& summary) {
    return is_null_at(summary, "truth") ? Json() : summary["truth"].value("alignment", Json());
  };
  if (alignment(a) != alignment(b)) return false;
  constexpr double kSame = 1e-5;  // m, rad, 1
  for (const auto& [section, name] :
       {std::pair("truth", "poses"), std::pair("closures", "true_inliers"), std::pair("ate_m", "odometry"),
        std::pair("ate_m", "optimized"), std::pair("ate_rad", "odometry"), std::pair("ate_rad", "optimized"),
        std::pair("ate_se3_m", "odometry"), std::pair("ate_se3_m", "optimized")}) {
    const auto x = number(a, section, name), y = number(b, section, name);
    if (x.has_value() != y.has_value() || (x && std::abs(*x - *y) > kSame)) return false;
  }
  return true;
}

/// Summaries of older versions, which called the reference poses of sessions the truth.
bool bring_up_to_date(Json& summary) {
  summary["residuals"] = nullptr;
  summary["reference"] = nullptr;
  summary["truth"] = nullptr;
  if (is_null_at(summary, "ate_m")) return false;
  if (!is_of_session(summary)) {
    summary["truth"] = {{"poses", nullptr}, {"alignment", "none"}};
    return false;
  }
  summary["reference"] = {{"poses", nullptr}, {"difference_m", summary["ate_m"]}};
  if (!is_null_at(summary, "ate_rad")) summary["reference"]["difference_rad"] = summary["ate_rad"];
  for (const char* name : {"ate_m", "ate_rad", "ate_se3_m", "ate_rmse_m", "rpe"}) summary[name] = nullptr;
  if (summary.contains("robots") && summary["robots"].is_object()) {
    for (auto& robot : summary["robots"]) robot = Json::object();
  }
  if (summary.contains("closures")) summary["closures"]["true_inliers"] = nullptr;
  return true;
}

}  // namespace

bool judge_run(const fs::path& folder, const Mission* mission, Json& summary,
               std::vector<std::string>& notes) {
  const bool is_of_today = summary.contains("truth");
  const bool has_truth = !is_null_at(summary, is_of_today ? "truth" : "ate_m");
  const bool knows_more =
      mission != nullptr && !mission->ground_truth.empty() && (!has_truth || !mission->truth_file.empty());
  const bool knows_better = mission != nullptr && !is_of_today && has_truth &&
                            mission->ground_truth.empty() && !mission->reference.empty();
  bool changed = is_of_today ? false : bring_up_to_date(summary);
  if (knows_more || knows_better) {
    if (const auto evaluation = evaluate_folder(folder, *mission)) {
      Json judged = summary;
      put_errors(*mission, *evaluation, judged);
      if (changed || !is_judged_alike(summary, judged)) {
        summary = std::move(judged);
        changed = true;
      }
    } else {
      notes.push_back("not judged by the mission's truth: needs graph.g2o, closures.csv and trajectories");
    }
  }
  if (changed) notes.push_back("errors over time are not known: the run knew another truth or none");
  return changed;
}

bool is_judgement(const std::string& column) {
  return column == "true_inliers" || column == "right_inliers" || column == "ate_m" ||
         column == "odometry_ate_m";
}

}  // namespace loopwise
