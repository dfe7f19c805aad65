// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/mission_summary.hpp>

#include <algorithm>
#include <limits>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_values.hpp>

namespace loopwise {
namespace {

/// Number of nodes, first and last key, and length of the path of each robot, in the order of the keys.
std::vector<RobotSummary> summarize_robots(const Mission& mission) {
  std::vector<RobotSummary> robots(mission.robots.size());
  std::vector<const Node*> nodes;
  for (const Node& node : mission.graph.nodes()) nodes.push_back(&node);
  std::sort(nodes.begin(), nodes.end(), [](const Node* a, const Node* b) { return a->key < b->key; });
  for (std::size_t r = 0; r < robots.size(); ++r) {
    robots[r].name = mission.robots[r].name;
    robots[r].landmarks = mission.robots[r].landmarks;
  }
  const Node* last = nullptr;  // of the preceding key frame
  std::optional<std::size_t> last_robot;
  for (const Node* node : nodes) {
    const std::optional<std::size_t> own = mission.robots.find(node->key);
    if (own) {
      RobotSummary& robot = robots[*own];
      ++robot.nodes;
      if (!robot.first_key) robot.first_key = node->key;
      robot.last_key = node->key;
    }
    if (mission.robots.is_landmark(node->key)) continue;
    if (last != nullptr && own && own == last_robot)
      robots[*own].length_m += (node->pose.translation() - last->pose.translation()).norm();
    last = node;
    last_robot = own;
  }
  return robots;
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

std::string key_text(const std::optional<Key>& key) {
  return key ? std::to_string(*key) : "-";
}

std::string robots_table(const MissionSummary& summary) {
  std::vector<std::vector<std::string>> rows{{"robot", "nodes", "length m", "first key", "last key"}};
  for (const RobotSummary& robot : summary.robots) {
    rows.push_back({robot.name, std::to_string(robot.nodes),
                    robot.landmarks ? "landmarks" : fixed(robot.length_m, 1), key_text(robot.first_key),
                    key_text(robot.last_key)});
  }
  return table(rows);
}

std::string graph_text(const MissionSummary& s) {
  std::string text = "\ngraph        " + std::to_string(s.nodes) + " nodes, " + std::to_string(s.edges) +
                     " edges (" + std::to_string(s.odometry_edges) + " odometry), " +
                     std::to_string(s.priors) + " priors, " + std::to_string(s.components) + " components" +
                     (s.planar ? ", planar" : "");
  if (s.sightings + s.ranges + s.gravity > 0) {
    text += "\nother        " + std::to_string(s.sightings) + " sightings of landmarks, " +
            std::to_string(s.ranges) + " ranges, gravity at " + std::to_string(s.gravity) + " nodes";
  }
  return text;
}

std::string scans_text(const MissionSummary& summary) {
  const PointCounts& points = summary.points;
  std::string text = "\nscans        " + std::to_string(summary.scans);
  if (points.scans > 0) {
    text += ", " + std::to_string(points.fewest) + " to " + std::to_string(points.most) + " points, mean " +
            fixed(points.mean(), 0);
  }
  return text;
}

std::string reference_text(const MissionSummary& summary) {
  if (summary.reference == 0) return {};
  return "\nreference    " + std::to_string(summary.reference) +
         " poses that another program optimised, not the truth; odometry differs by " +
         fixed(summary.reference_difference_m.mean, 2) + " m in the mean, " +
         fixed(summary.reference_difference_m.max, 2) + " m at most";
}

}  // namespace

PointCounts count_points(const ScanStore& scans, const StopToken& stop, const ProgressCallback& progress) {
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
    if (progress) progress({"reading scans", i + 1, keys.size(), ""});
  }
  return counts;
}

MissionSummary summarize_mission(const Mission& mission, const PointCounts& points) {
  const PoseGraph& graph = mission.graph;
  MissionSummary s;
  s.kind = mission.kind;
  s.name = mission.name;
  s.robots = summarize_robots(mission);
  for (const RobotSummary& robot : s.robots) s.length_m += robot.length_m;
  s.duration_s = duration_of(mission);
  s.nodes = graph.nodes().size();
  s.planar = graph.planar();
  s.edges = graph.edges().size();
  for (const Edge& edge : graph.edges()) {
    s.odometry_edges += edge.kind == EdgeKind::kOdometry ? 1 : 0;
    s.sightings += edge.kind == EdgeKind::kLandmark ? 1 : 0;
  }
  s.priors = graph.priors().size();
  s.ranges = graph.ranges().size();
  s.gravity = graph.gravities().size();
  const std::vector<std::size_t> components = connected_components(graph);
  if (!components.empty()) s.components = 1 + *std::max_element(components.begin(), components.end());
  s.scans = mission.scans->size();
  s.points = points;
  s.ground_truth = mission.ground_truth.size();
  s.reference = mission.reference.size();
  if (s.reference > 0) {
    s.reference_difference_m =
        evaluate_trajectory(poses_by_key(graph), mission.reference, Alignment::kNone, mission.robots).ate_m;
  }
  s.radio_readings = mission.radio.size();
  s.beacons = mission.beacons.size();
  s.communication_gaps = mission.gaps.size();
  s.problems = mission.problems;
  s.problems.add(mission.scans->problems());
  return s;
}

std::string mission_summary_json(const MissionSummary& s) {
  Json robots = Json::array();
  for (const RobotSummary& robot : s.robots) {
    robots.push_back({{"name", robot.name},
                      {"nodes", robot.nodes},
                      {"length_m", robot.length_m},
                      {"first_key", key_text(robot.first_key)},
                      {"last_key", key_text(robot.last_key)},
                      {"landmarks", robot.landmarks}});
  }
  const Json json = {{"kind", enum_name(s.kind)},
                     {"name", s.name},
                     {"run", s.kind == MissionKind::kRun},
                     {"robots", robots},
                     {"nodes", s.nodes},
                     {"planar", s.planar},
                     {"edges", s.edges},
                     {"odometry_edges", s.odometry_edges},
                     {"priors", s.priors},
                     {"sightings", s.sightings},
                     {"ranges", s.ranges},
                     {"gravity", s.gravity},
                     {"components", s.components},
                     {"scans", s.scans},
                     {"points",
                      {{"total", s.points.total},
                       {"min", s.points.fewest},
                       {"mean", s.points.mean()},
                       {"max", s.points.most}}},
                     {"ground_truth", s.ground_truth},
                     {"reference", s.reference},
                     {"radio_readings", s.radio_readings},
                     {"beacons", s.beacons},
                     {"communication_gaps", s.communication_gaps},
                     {"length_m", s.length_m},
                     {"duration_s", s.duration_s},
                     {"problems", problems_json(s.problems)}};
  return json_text(json);
}

std::string mission_summary_text(const MissionSummary& s) {
  const std::string kind = s.kind == MissionKind::kRun ? "results of a replay" : enum_name(s.kind);
  return kind + " \"" + s.name + "\"\n" + robots_table(s) + graph_text(s) + scans_text(s) +
         "\nlength       " + fixed(s.length_m, 1) + " m in " + fixed(s.duration_s, 1) + " s\ntruth        " +
         std::to_string(s.ground_truth) + " poses" + reference_text(s) + "\nradio        " +
         std::to_string(s.radio_readings) + " readings, " + std::to_string(s.beacons) + " beacons, " +
         std::to_string(s.communication_gaps) + " communication gaps\n";
}

}  // namespace loopwise
