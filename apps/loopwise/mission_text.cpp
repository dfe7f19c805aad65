// SPDX-License-Identifier: BSD-3-Clause
#include "mission_text.hpp"

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>

#include "command.hpp"

namespace loopwise::cli {
namespace {

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

/// Differences to the poses of another program for the same run.
std::string reference_text(const Mission& mission) {
  if (mission.reference.empty()) return {};
  const TrajectoryErrors off =
      evaluate_trajectory(poses_by_key(mission.graph), mission.reference, Alignment::kNone, mission.robots);
  return "\nreference    " + std::to_string(mission.reference.size()) +
         " poses that another program optimised, not the truth; odometry differs by " +
         fixed(off.ate_m.mean, 2) + " m in the mean, " + fixed(off.ate_m.max, 2) + " m at most";
}

/// Time between the first and the last key frame, s.
double duration_of(const Mission& mission) {
  std::int64_t first = std::numeric_limits<std::int64_t>::max(),
               last = std::numeric_limits<std::int64_t>::min();
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.is_landmark(node.key)) continue;
    first = std::min(first, node.stamp_ns);
    last = std::max(last, node.stamp_ns);
  }
  return last < first ? 0.0 : static_cast<double>(last - first) * 1e-9;
}

/// Adds a row for each robot. \returns the length of all paths, m
double add_robots(const Mission& mission, Json& json, std::string& text) {
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
  json["robots"] = robots;
  text += table(rows);
  return length;
}

/// Adds the figures of the graph.
void add_graph(const Mission& mission, Json& json, std::string& text) {
  const PoseGraph& graph = mission.graph;
  std::size_t odometry = 0, sightings = 0;
  for (const Edge& edge : graph.edges()) {
    odometry += edge.kind == EdgeKind::kOdometry ? 1 : 0;
    sightings += edge.kind == EdgeKind::kLandmark ? 1 : 0;
  }
  const auto components = connected_components(graph);
  const std::size_t component_count =
      components.empty() ? 0 : 1 + *std::max_element(components.begin(), components.end());
  json["nodes"] = graph.nodes().size();
  json["planar"] = graph.planar();
  json["edges"] = graph.edges().size();
  json["odometry_edges"] = odometry;
  json["priors"] = graph.priors().size();
  json["sightings"] = sightings;
  json["ranges"] = graph.ranges().size();
  json["gravity"] = graph.gravities().size();
  json["components"] = component_count;
  text += "\ngraph        " + std::to_string(graph.nodes().size()) + " nodes, " +
          std::to_string(graph.edges().size()) + " edges (" + std::to_string(odometry) + " odometry), " +
          std::to_string(graph.priors().size()) + " priors, " + std::to_string(component_count) +
          " components" + (graph.planar() ? ", planar" : "");
  if (sightings + graph.ranges().size() + graph.gravities().size() > 0) {
    text += "\nother        " + std::to_string(sightings) + " sightings of landmarks, " +
            std::to_string(graph.ranges().size()) + " ranges, gravity at " +
            std::to_string(graph.gravities().size()) + " nodes";
  }
}

/// Adds the figures of the scans.
void add_scans(const Mission& mission, const PointCounts& points, Json& json, std::string& text) {
  const double mean =
      points.scans == 0 ? 0.0 : static_cast<double>(points.total) / static_cast<double>(points.scans);
  json["scans"] = mission.scans->size();
  json["points"] = {{"total", points.total}, {"min", points.fewest}, {"mean", mean}, {"max", points.most}};
  text += "\nscans        " + std::to_string(mission.scans->size());
  if (points.scans > 0) {
    text += ", " + std::to_string(points.fewest) + " to " + std::to_string(points.most) + " points, mean " +
            fixed(mean, 0);
  }
}

}  // namespace

void describe_mission(const Mission& mission, const PointCounts& points, const Problems& problems, Json& json,
                      std::string& text) {
  const bool is_run = mission.kind == MissionKind::kRun;
  json = {{"kind", enum_name(mission.kind)}, {"name", mission.name}, {"run", is_run}};
  text = (is_run ? "results of a replay" : enum_name(mission.kind)) + " \"" + mission.name + "\"\n";
  const double length = add_robots(mission, json, text), duration_s = duration_of(mission);
  add_graph(mission, json, text);
  add_scans(mission, points, json, text);
  json["ground_truth"] = mission.ground_truth.size();
  json["reference"] = mission.reference.size();
  json["radio_readings"] = mission.radio.size();
  json["beacons"] = mission.beacons.size();
  json["communication_gaps"] = mission.gaps.size();
  json["length_m"] = length;
  json["duration_s"] = duration_s;
  json["problems"] = Json::array();
  for (const Problem& problem : problems.all()) json["problems"].push_back(to_string(problem));
  text += "\nlength       " + fixed(length, 1) + " m in " + fixed(duration_s, 1) + " s\ntruth        " +
          std::to_string(mission.ground_truth.size()) + " poses" + reference_text(mission) +
          "\nradio        " + std::to_string(mission.radio.size()) + " readings, " +
          std::to_string(mission.beacons.size()) + " beacons, " + std::to_string(mission.gaps.size()) +
          " communication gaps\n";
}

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

void add_topics(const Mission& mission, Json& json, std::string& text) {
  if (mission.topics.empty()) return;
  Json all = Json::array();
  std::vector<std::vector<std::string>> rows{{"topic", "type", "messages", "used as"}};
  for (const RecordedTopic& topic : mission.topics) {
    all.push_back(
        {{"name", topic.name}, {"type", topic.type}, {"messages", topic.messages}, {"use", topic.use}});
    rows.push_back(
        {topic.name, topic.type, std::to_string(topic.messages), topic.use.empty() ? "-" : topic.use});
  }
  json["topics"] = all;
  text += "\n" + table(rows);
}

}  // namespace loopwise::cli
