// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/run_folder.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <optional>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>
#include <loopwise/evaluation/run_picture.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/output_folder.hpp>
#include <loopwise/io/trajectory.hpp>

#include "../core/constants.hpp"
#include "run_errors.hpp"

namespace loopwise {
namespace {

PosesByKey odometry_poses(const ReplayResult& result) {
  PosesByKey poses;
  for (std::size_t i = 0; i < result.graph.nodes().size(); ++i) {
    poses[result.graph.nodes()[i].key] = result.odometry[i];
  }
  return poses;
}

std::vector<double> weights_of(const ReplayResult& result) {
  std::vector<double> weights;
  for (const ComputedCandidate& computed : result.computed) weights.push_back(computed.weight);
  return weights;
}

/// Shortest text that reads back to the same bits; "nan" for NaN.
std::string figure(double value) {
  if (std::isnan(value)) return "nan";
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

Json counts_json(const std::map<std::string, std::size_t>& counts) {
  Json json = Json::object();
  for (const auto& [name, count] : counts) json[name] = count;
  return json;
}

}  // namespace

RunEvaluation evaluate_run(const Mission& mission, const ReplayResult& result) {
  RunEvaluation evaluation;
  std::vector<RegistrationResult> results;
  for (const ComputedCandidate& computed : result.computed) results.push_back(computed.result);
  const std::vector<double> weights = weights_of(result);
  evaluation.closures =
      closure_statistics(results, weights, result.accounting.queued(), mission.ground_truth);
  std::vector<LoopClosure> kept;
  for (std::size_t i = 0; i < results.size(); ++i) {
    if (results[i].verified() && weights[i] > ClosureClassOptions().gnc_inlier_weight)
      kept.push_back(*results[i].closure);
  }
  judge_poses(mission, poses_by_key(result.graph), odometry_poses(result), kept, evaluation);
  return evaluation;
}

namespace {

/// Brier score and reliability table.
Json calibration_json(const Calibration& calibration) {
  Json table = Json::array();
  for (std::size_t i = 0; i < calibration.bins().size(); ++i) {
    const Calibration::Bin& bin = calibration.bins()[i];
    if (bin.count == 0) continue;
    table.push_back({{"from", static_cast<double>(i) / 10.0},
                     {"to", static_cast<double>(i + 1) / 10.0},
                     {"count", bin.count},
                     {"expected", bin.expected / static_cast<double>(bin.count)},
                     {"verified", static_cast<double>(bin.verified) / static_cast<double>(bin.count)}});
  }
  return {{"brier", number_or_null(calibration.brier())}, {"table", table}};
}

}  // namespace

std::string run_summary_json(const Mission& mission, const ReplayOptions& options, const ReplayResult& result,
                             const RunEvaluation& e) {
  const CandidateAccounting& a = result.accounting;
  Json json = Json::object();
  json["mission"] = mission.name;
  json["method"] = to_string(options.prioritization.method);
  json["seed"] = options.engine.seed;
  json["interrupted"] = result.interrupted;
  json["mission_time_s"] = result.mission_time_s;
  json["mission_end_s"] = result.mission_end_s;
  json["key_frames"] = result.graph.nodes().size();
  json["batches"] = result.batches;
  json["optimizations"] = result.optimizations;
  json["continued_optimizations"] = result.continued_optimizations;
  json["candidates"] = {{"generated", a.generated}, {"pruned", a.pruned},   {"expired", a.expired},
                        {"waiting", a.waiting},     {"pending", a.pending}, {"in_flight", a.in_flight},
                        {"computed", a.computed},   {"queued", a.queued()}};
  json["closures"] = {
      {"verified", e.closures.verified}, {"gnc_inliers", e.closures.gnc_inliers}, {"true_inliers", nullptr}};
  Json reasons = Json::object();
  for (const auto& [reason, count] : e.closures.rejected) reasons[enum_name(reason)] = count;
  json["reasons"] = reasons;
  json["pruned_reasons"] = counts_json(result.pruned);
  json["expired_reasons"] = counts_json(result.expired);
  Json handed_out = Json::object();
  for (const auto& [name, count] : result.handed_out) handed_out[name] = count;
  json["handed_out"] = handed_out;
  for (const auto& [name, calibration] : result.calibration) {
    json["calibration"][name] = calibration_json(calibration);
  }
  put_errors(mission, e, json);
  const Eigen::Vector3d origin = map_origin(result.graph);
  json["map_origin_m"] = {origin.x(), origin.y(), origin.z()};
  json["seconds"] = {{"total", result.total_s},
                     {"registration", result.registration_s},
                     {"optimization", result.optimization_s}};
  json["options"] = parse_json(options_json(options), "options");
  json["problems"] = problems_json(mission.problems);
  for (Json& problem : problems_json(result.problems)) json["problems"].push_back(std::move(problem));
  return json_text(json, 2) + "\n";
}

std::string closures_csv(const ReplayResult& result) {
  CsvText csv({"from", "to", "source", "outcome", "reason", "x", "y", "z", "qx", "qy", "qz", "qw", "fitness",
               "overlap", "weight", "mission_time_s", "seconds"});
  for (const ComputedCandidate& computed : result.computed) {
    const RegistrationResult& r = computed.result;
    Eigen::Matrix<double, 7, 1> pose = Eigen::Matrix<double, 7, 1>::Constant(kNan);
    const auto T = r.closure ? std::optional<Eigen::Isometry3d>(r.closure->T_from_to) : r.T_from_to;
    if (T) pose << T->translation(), Eigen::Quaterniond(T->linear()).coeffs();
    csv.row(r.candidate.from, r.candidate.to, enum_name(r.candidate.source),
            r.verified() ? "verified" : "rejected", enum_name(r.reason), figure(pose[0]), figure(pose[1]),
            figure(pose[2]), figure(pose[3]), figure(pose[4]), figure(pose[5]), figure(pose[6]),
            figure(r.gicp_fitness_m2), figure(r.overlap), figure(computed.weight),
            figure(computed.mission_time_s), figure(r.seconds()));
  }
  return csv.text();
}

Eigen::Vector3d map_origin(const PoseGraph& graph) {
  constexpr double kNear_m = 10000.0;  // floats are 1 mm apart there
  std::vector<Eigen::Vector3d> places;
  for (const Node& node : graph.nodes()) places.emplace_back(node.pose.translation());
  const Eigen::Vector3d middle = robust_centre(places);
  if (middle.norm() < kNear_m) return Eigen::Vector3d::Zero();
  return middle.array().round();
}

StitchedMap stitch_map(const PoseGraph& graph, const ScanStore& scans, double voxel_m, const StopToken& stop,
                       const ProgressCallback& progress, double max_range_m) {
  // Thinned again each time its size has doubled: the memory stays near that of the final map.
  constexpr std::size_t kSmall = 1000000;
  StitchedMap out;
  PointCloud& map = out.cloud;
  map.origin = map_origin(graph);
  std::size_t limit = kSmall;
  for (std::size_t i = 0; i < graph.nodes().size() && !stop.stop_requested(); ++i) {
    const Node& node = graph.nodes()[i];
    std::shared_ptr<const PointCloud> scan;
    try {
      scan = scans.load(node.key);
    } catch (const Error&) {
      continue;  // the store has counted the problem
    }
    if (!scan) continue;
    const PointCloud near = within_range(*scan, max_range_m);
    count_far_points(out.problems, "scan " + key_name(node.key), scan->size() - near.size(), max_range_m);
    const Eigen::Matrix3d R = node.pose.linear();
    const Eigen::Vector3d t = node.pose.translation() - map.origin;
    for (const Eigen::Vector3f& p : near.points) {
      map.points.emplace_back((R * p.cast<double>() + t).cast<float>());
    }
    if (map.size() > limit) {
      map = voxel_downsample(map, voxel_m);
      limit = std::max(kSmall, 2 * map.size());
    }
    if (progress) progress({"stitching the map", i + 1, graph.nodes().size(), ""});
  }
  if (!map.empty()) map = voxel_downsample(map, voxel_m);
  return out;
}

void add_scan_problems(ReplayResult& result, const ScanStore& scans) {
  const Problems now = scans.problems();
  for (const Problem& problem : now.all()) {
    const std::size_t known = result.problems.count(problem.kind);
    if (problem.count <= known) continue;
    const std::size_t more = problem.count - known;
    if (problem.altered) {
      result.problems.add_altered(problem.kind, problem.example, more);
    } else {
      result.problems.add(problem.kind, problem.example, more);
    }
  }
}

PointCloud map_of_run(const Mission& mission, ReplayResult& result, double voxel_m, const StopToken& stop,
                      const ProgressCallback& progress, double max_range_m) {
  StitchedMap map = stitch_map(result.graph, *mission.scans, voxel_m, stop, progress, max_range_m);
  result.problems.add(map.problems);
  add_scan_problems(result, *mission.scans);
  return std::move(map.cloud);
}

void remove_run_results(const std::filesystem::path& folder) {
  for (const char* name : {"summary.json", "odometry.csv", "map.pcd", "map.ply", "picture.svg"})
    remove_former(folder / name);
  // The earlier run may have had other robots.
  if (!std::filesystem::is_directory(folder / "trajectories")) return;
  std::vector<std::filesystem::path> trajectories;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "trajectories")) {
    if (entry.path().extension() == ".tum") trajectories.push_back(entry.path());
  }
  for (const std::filesystem::path& file : trajectories) remove_former(file);
}

void write_run_folder(const std::filesystem::path& folder, const Mission& mission,
                      const ReplayOptions& options, const ReplayResult& result,
                      const RunEvaluation& evaluation, const std::vector<HistoryRow>& history,
                      const PointCloud& map) {
  write_g2o(folder / "graph.g2o", result.graph);
  if (const std::string list = odometry_list(result.graph, mission.robots); !list.empty())
    write_file(folder / "odometry.csv", list);
  std::error_code failure;
  std::filesystem::create_directories(folder / "trajectories", failure);
  if (failure) throw IoError((folder / "trajectories").string(), failure.message());
  std::set<std::string> names;
  for (std::size_t robot = 0; robot < mission.robots.size(); ++robot) {
    if (mission.robots[robot].landmarks) continue;
    std::vector<std::pair<Key, std::size_t>> own;
    for (std::size_t i = 0; i < result.graph.nodes().size(); ++i) {
      if (mission.robots.of(result.graph.nodes()[i].key) == robot)
        own.emplace_back(result.graph.nodes()[i].key, i);
    }
    std::sort(own.begin(), own.end());
    std::vector<StampedPose> optimized, odometry;
    for (const auto& [key, i] : own) {
      const Node& node = result.graph.nodes()[i];
      optimized.push_back({node.stamp_ns, node.pose});
      odometry.push_back({node.stamp_ns, result.odometry[i]});
    }
    std::string name = plain_file_name(mission.robots[robot].name);
    while (names.count(name) + names.count(name + "_odometry") > 0) name += "_" + std::to_string(robot);
    names.insert({name, name + "_odometry"});
    write_tum(folder / "trajectories" / (name + ".tum"), optimized);
    write_tum(folder / "trajectories" / (name + "_odometry.tum"), odometry);
  }
  write_file(folder / "closures.csv", closures_csv(result));
  write_file(folder / "history.csv", history_csv(history));
  if (!map.empty()) {
    write_pcd(folder / "map.pcd", map);
    write_file(folder / "picture.svg", run_picture_svg(mission, result, map));
  }
  write_file(folder / "summary.json", run_summary_json(mission, options, result, evaluation));
}

}  // namespace loopwise
