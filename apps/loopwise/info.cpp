// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/mission_picture.hpp>
#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/cost_forecast.hpp>

#include "command.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::vector<std::string> paths, truth;
  std::string frames;
  std::string bin_layout;
  bool start_together = false;
  std::string robots;
  std::string picture;
  CandidateStatisticsOptions candidates;
  std::int64_t timed = 40;
  bool read_scans = true;
};

constexpr double kDegrees = 57.29577951308232;

/// Length of each robot's path along its nodes, in the order of their keys.
std::vector<double> path_lengths(const Mission& mission) {
  std::vector<double> lengths(mission.robots.size(), 0.0);
  std::vector<std::pair<Key, Eigen::Vector3d>> nodes;
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.robots.is_landmark(node.key)) nodes.emplace_back(node.key, node.pose.translation());
  }
  std::sort(nodes.begin(), nodes.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (std::size_t i = 1; i < nodes.size(); ++i) {
    const auto robot = mission.robots.find(nodes[i].first);
    if (robot && robot == mission.robots.find(nodes[i - 1].first)) {
      lengths[*robot] += (nodes[i].second - nodes[i - 1].second).norm();
    }
  }
  return lengths;
}

struct PointCounts {
  std::size_t scans = 0, total = 0, fewest = 0, most = 0;
};

PointCounts count_points(const ScanStore& scans, Console& console, const StopToken& stop) {
  PointCounts counts;
  const std::vector<Key> keys = scans.keys();
  for (std::size_t i = 0; i < keys.size() && !stop.stop_requested(); ++i) {
    try {
      const auto cloud = scans.load(keys[i]);
      if (!cloud) continue;
      counts.fewest = counts.scans == 0 ? cloud->size() : std::min(counts.fewest, cloud->size());
      counts.most = std::max(counts.most, cloud->size());
      counts.total += cloud->size();
      ++counts.scans;
    } catch (const Error&) {
      // The scan store counts it among its problems.
    }
    console.progress({"reading scans", i + 1, keys.size(), ""});
  }
  return counts;
}

int cloud_info(const Options& options, const Config& config, Console& console) {
  const CloudFile file = read_cloud(options.paths.front(), config.mission.bin_layout);
  console.warn(file.problems);
  Json problems = Json::array();
  for (const Problem& problem : file.problems.all()) problems.push_back(to_string(problem));
  const Eigen::Vector3d& origin = file.cloud.origin;
  const Json json = {{"kind", "cloud"},
                     {"origin_m", {origin.x(), origin.y(), origin.z()}},
                     {"robots", Json::array()},
                     {"nodes", 0},
                     {"edges", 0},
                     {"scans", 1},
                     {"points",
                      {{"total", file.cloud.size()},
                       {"min", file.cloud.size()},
                       {"mean", file.cloud.size()},
                       {"max", file.cloud.size()}}},
                     {"length_m", 0.0},
                     {"duration_s", 0.0},
                     {"problems", problems}};
  print_results(
      options.common, json,
      "cloud        " + std::to_string(file.cloud.size()) + " points" +
          (file.cloud.has_normals() ? ", normals" : "") +
          (file.cloud.intensities.empty() ? "" : ", intensity") + "\n" +
          (origin.isZero(0.0) ? ""
                              : "origin       " + fixed(origin.x(), 0) + " " + fixed(origin.y(), 0) + " " +
                                    fixed(origin.z(), 0) + " m: world coordinates\n"));
  return kDone;
}

Json number(double value) {
  return std::isnan(value) ? Json() : Json(value);
}

/// Adds the drift of odometry, if ground truth is known.
void add_drift(const Mission& mission, Json& json, std::string& text) {
  const std::vector<RobotDrift> drifts = odometry_drift(mission);
  Json all = Json::array();
  std::vector<std::vector<std::string>> rows{
      {"drift of", "largest m", "% of length", "largest deg", "end m"}};
  for (const RobotDrift& drift : drifts) {
    all.push_back({{"robot", drift.robot},
                   {"length_m", drift.length_m},
                   {"largest_error_m", drift.largest_m},
                   {"largest_error_rad", drift.largest_rad},
                   {"end_error_m", drift.end_m}});
    rows.push_back({drift.robot, fixed(drift.largest_m, 2),
                    fixed(100.0 * drift.largest_m / drift.length_m, 2),
                    fixed(drift.largest_rad * kDegrees, 2), fixed(drift.end_m, 2)});
  }
  json["drift"] = all;
  if (!drifts.empty()) text += "\n" + table(rows);
}

/// Adds the number of candidates by proximity, and the number of those that saw the same place.
void add_candidates(const Mission& mission, const Options& options, Json& json, std::string& text) {
  CandidateStatisticsOptions wanted = options.candidates;
  wanted.threads = thread_count(options.common);
  if (!options.read_scans) wanted.pairs = 0;
  const CandidateStatistics found = candidate_statistics(mission, wanted);
  json["candidates"] = {{"radius_m", wanted.radius_m},
                        {"generated", found.candidates},
                        {"looked_at", found.looked_at},
                        {"mean_overlap", number(found.mean_overlap)},
                        {"overlapping", number(found.overlapping)},
                        {"within_radius", number(found.within_radius)}};
  text += "pairs        " + std::to_string(found.candidates) + " of nodes within " +
          fixed(wanted.radius_m, 0) + " m";
  if (found.looked_at > 0) {
    text += "; the scans of " + fixed(100.0 * found.overlapping, 1) +
            " % overlap at the true poses (sample of " + std::to_string(found.looked_at) + ")";
  }
  text += "\n";
}

/// Adds the time that all of them would take on this machine.
void add_cost(const Mission& mission, const Options& options, const ReplayOptions& replay,
              const StopToken& stop, Json& json, std::string& text) {
  if (!options.read_scans || options.timed <= 0 || mission.scans->size() == 0) return;
  const CostForecast forecast = forecast_cost(mission, replay, static_cast<std::size_t>(options.timed), stop);
  const int threads = thread_count(options.common);
  if (forecast.measured == 0) return;
  json["all_candidates"] = {{"candidates", forecast.candidates},         {"measured", forecast.measured},
                            {"registration_s", forecast.registration_s}, {"threads", threads},
                            {"all_s", forecast.all_s(threads)},          {"mission_s", forecast.mission_s}};
  text += "all of them  " + forecast_text(forecast, threads) + "\n";
}

/// Differences to the poses of another program for the same run.
std::string reference_text(const Mission& mission) {
  if (mission.reference.empty()) return {};
  const TrajectoryErrors off =
      evaluate_trajectory(poses_by_key(mission.graph), mission.reference, Alignment::kNone, mission.robots);
  return "\nreference    " + std::to_string(mission.reference.size()) +
         " poses that another program optimised, not the truth; odometry differs by " +
         fixed(off.ate_m.mean, 2) + " m in the mean, " + fixed(off.ate_m.max, 2) + " m at most";
}

/// Adds the topics of the bags and the data taken from each.
void add_topics(const Mission& mission, Json& json, std::string& text) {
  if (mission.topics.empty()) return;
  Json all = Json::array();
  std::vector<std::vector<std::string>> rows{{"topic", "type", "messages", "taken for"}};
  for (const RecordedTopic& topic : mission.topics) {
    all.push_back(
        {{"name", topic.name}, {"type", topic.type}, {"messages", topic.messages}, {"use", topic.use}});
    rows.push_back(
        {topic.name, topic.type, std::to_string(topic.messages), topic.use.empty() ? "-" : topic.use});
  }
  json["topics"] = all;
  text += "\n" + table(rows);
}

int run(const Options& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  if (!options.robots.empty()) config.mission.robots = options.robots;
  if (!options.frames.empty()) config.mission.frames = options.frames;
  if (options.start_together) config.mission.start_together = true;
  apply_bin_layout(options.bin_layout, config);
  const std::vector<std::filesystem::path> paths(options.paths.begin(), options.paths.end());
  if (paths.size() == 1 && std::filesystem::is_regular_file(paths[0]) && is_cloud_file(paths[0])) {
    return cloud_info(options, config, console);
  }
  Mission mission = read_missions(paths, config.mission, console.progress_callback(), interrupt.token());
  set_truth(mission, options.truth, config.mission);
  const PointCounts points =
      options.read_scans ? count_points(*mission.scans, console, interrupt.token()) : PointCounts{};

  Problems problems = mission.problems;
  problems.add(mission.scans->problems());
  std::int64_t first = std::numeric_limits<std::int64_t>::max(),
               last = std::numeric_limits<std::int64_t>::min();
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.is_landmark(node.key)) continue;
    first = std::min(first, node.stamp_ns);
    last = std::max(last, node.stamp_ns);
  }
  const double duration_s = last < first ? 0.0 : static_cast<double>(last - first) * 1e-9;
  const std::vector<double> lengths = path_lengths(mission);
  double length = 0.0;
  Json robots = Json::array();
  std::vector<std::vector<std::string>> rows{{"robot", "nodes", "length m", "first key", "last key"}};
  for (std::size_t r = 0; r < mission.robots.size(); ++r) {
    std::vector<Key> own;
    for (const Node& node : mission.graph.nodes()) {
      if (mission.robots.find(node.key) == r) own.push_back(node.key);
    }
    length += lengths[r];
    const auto [low, high] = std::minmax_element(own.begin(), own.end());
    const std::string from = own.empty() ? "-" : std::to_string(*low),
                      to = own.empty() ? "-" : std::to_string(*high);
    robots.push_back({{"name", mission.robots[r].name},
                      {"nodes", own.size()},
                      {"length_m", lengths[r]},
                      {"first_key", from},
                      {"last_key", to},
                      {"landmarks", mission.robots[r].landmarks}});
    rows.push_back({mission.robots[r].name, std::to_string(own.size()),
                    mission.robots[r].landmarks ? "landmarks" : fixed(lengths[r], 1), from, to});
  }
  std::size_t odometry = 0, sightings = 0;
  for (const Edge& edge : mission.graph.edges()) {
    odometry += edge.kind == EdgeKind::kOdometry ? 1 : 0;
    sightings += edge.kind == EdgeKind::kLandmark ? 1 : 0;
  }
  const auto components = connected_components(mission.graph);
  const std::size_t component_count =
      components.empty() ? 0 : 1 + *std::max_element(components.begin(), components.end());
  Json problem_list = Json::array();
  for (const Problem& problem : problems.all()) problem_list.push_back(to_string(problem));
  const bool is_run = mission.kind == MissionKind::kRun;
  const double mean =
      points.scans == 0 ? 0.0 : static_cast<double>(points.total) / static_cast<double>(points.scans);
  Json json = {
      {"kind", enum_name(mission.kind)},
      {"name", mission.name},
      {"run", is_run},
      {"robots", robots},
      {"nodes", mission.graph.nodes().size()},
      {"planar", mission.graph.planar()},
      {"edges", mission.graph.edges().size()},
      {"odometry_edges", odometry},
      {"priors", mission.graph.priors().size()},
      {"sightings", sightings},
      {"ranges", mission.graph.ranges().size()},
      {"gravity", mission.graph.gravities().size()},
      {"components", component_count},
      {"scans", mission.scans->size()},
      {"points", {{"total", points.total}, {"min", points.fewest}, {"mean", mean}, {"max", points.most}}},
      {"ground_truth", mission.ground_truth.size()},
      {"reference", mission.reference.size()},
      {"radio_readings", mission.radio.size()},
      {"beacons", mission.beacons.size()},
      {"communication_gaps", mission.gaps.size()},
      {"length_m", length},
      {"duration_s", duration_s},
      {"problems", problem_list}};
  std::string text = (is_run ? "results of a replay" : enum_name(mission.kind)) + " \"" + mission.name +
                     "\"\n" + table(rows);
  text += "\ngraph        " + std::to_string(mission.graph.nodes().size()) + " nodes, " +
          std::to_string(mission.graph.edges().size()) + " edges (" + std::to_string(odometry) +
          " odometry), " + std::to_string(mission.graph.priors().size()) + " priors, " +
          std::to_string(component_count) + " components" + (mission.graph.planar() ? ", planar" : "");
  if (sightings + mission.graph.ranges().size() + mission.graph.gravities().size() > 0) {
    text += "\nother        " + std::to_string(sightings) + " sightings of landmarks, " +
            std::to_string(mission.graph.ranges().size()) + " ranges, gravity at " +
            std::to_string(mission.graph.gravities().size()) + " nodes";
  }
  text += "\nscans        " + std::to_string(mission.scans->size());
  if (points.scans > 0) {
    text += ", " + std::to_string(points.fewest) + " to " + std::to_string(points.most) + " points, mean " +
            fixed(mean, 0);
  }
  text += "\nlength       " + fixed(length, 1) + " m in " + fixed(duration_s, 1) + " s\ntruth        " +
          std::to_string(mission.ground_truth.size()) + " poses" + reference_text(mission) +
          "\nradio        " + std::to_string(mission.radio.size()) + " readings, " +
          std::to_string(mission.beacons.size()) + " beacons, " + std::to_string(mission.gaps.size()) +
          " communication gaps\n";
  add_candidates(mission, options, json, text);
  add_cost(mission, options, config.replay, interrupt.token(), json, text);
  add_drift(mission, json, text);
  add_topics(mission, json, text);
  if (!options.picture.empty()) write_file(options.picture, mission_picture_svg(mission));
  for (const Problem& problem : problems.all()) text += "problem      " + to_string(problem) + "\n";
  print_results(options.common, json, text);
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace

void add_info(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("info", "Describe a mission, session, graph or cloud");
  command->footer("  loopwise info my_mission --picture my_mission.svg");
  command
      ->add_option("path", options->paths,
                   "Mission folder, session, g2o file, g2o_pcd folder, bag, saved map or cloud; several "
                   "bags, or several missions of one robot, are read as one")
      ->required()
      ->type_name("PATH");
  command->add_option("--robots", options->robots, "Robots by ranges of ids or by characters")
      ->type_name("LIST");
  command
      ->add_option("--radius", options->candidates.radius_m, "Count candidates within M metres (default 30)")
      ->type_name("M");
  command
      ->add_option("--pairs", options->candidates.pairs,
                   "Candidates whose scans are compared at the true poses (default 1000)")
      ->type_name("N");
  command
      ->add_option("--timed", options->timed,
                   "Candidates to register, to estimate the time of all of them; 0: no estimate (default 40)")
      ->check(CLI::Range(0, 1000000))
      ->type_name("N");
  add_joining_options(*command, options->frames, options->start_together);
  add_truth_option(*command, options->truth);
  add_bin_layout_option(*command, options->bin_layout);
  command->add_option("--picture", options->picture, "Draw the mission from above, as SVG")
      ->type_name("FILE")
      ->check(not_standard_output());
  command->add_flag("!--no-scans", options->read_scans, "Do not open the scans");
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
