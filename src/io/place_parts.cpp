// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/place_parts.hpp>

#include <map>
#include <set>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "mission_parts.hpp"

namespace loopwise {
namespace {

/// Maps each node of a mission to its part.
class PartOfNode {
 public:
  PartOfNode(const Mission& mission, const std::vector<MissionPart>& parts) : robots_(mission.robots) {
    for (std::size_t p = 0; p < parts.size(); ++p) {
      for (const std::size_t robot : parts[p].robots) {
        if (robot >= robots_.size())
          throw InputError("part " + std::to_string(p) + ": unknown robot " + std::to_string(robot));
        if (!part_of_robot_.emplace(robot, p).second)
          throw InputError("robot \"" + robots_[robot].name + "\" is in two parts");
      }
    }
    const auto tie = [&](Key a, Key b) {
      if (robots_.is_landmark(a)) std::swap(a, b);
      if (!robots_.is_landmark(b) || robots_.is_landmark(a)) return;
      if (const auto part = (*this)(a)) part_of_landmark_.emplace(b, *part);
    };
    for (const Edge& edge : mission.graph.edges()) tie(edge.from, edge.to);
    for (const RangeFactor& range : mission.graph.ranges()) tie(range.from, range.to);
  }

  /// Empty if the node belongs to no part.
  [[nodiscard]] std::optional<std::size_t> operator()(Key key) const {
    if (robots_.is_landmark(key)) {
      const auto found = part_of_landmark_.find(key);
      return found == part_of_landmark_.end() ? std::nullopt : std::optional<std::size_t>(found->second);
    }
    const auto robot = robots_.find(key);
    const auto found = robot ? part_of_robot_.find(*robot) : part_of_robot_.end();
    return found == part_of_robot_.end() ? std::nullopt : std::optional<std::size_t>(found->second);
  }

 private:
  const Robots& robots_;
  std::map<std::size_t, std::size_t> part_of_robot_;
  std::map<Key, std::size_t> part_of_landmark_;
};

void place_priors(const Mission& mission, const std::vector<MissionPart>& parts, const PartOfNode& part_of,
                  PoseGraph& graph) {
  for (PriorFactor prior : mission.graph.priors()) {
    const auto part = part_of(prior.key);
    const bool replaced = part && parts[*part].sigmas && !mission.robots.is_landmark(prior.key);
    if (!part || replaced) continue;
    prior.pose = se3::normalized(parts[*part].T_common_part * prior.pose);
    graph.add_prior(prior);
  }
  for (const Key key : parts::first_nodes(mission.graph, mission.robots)) {
    const auto part = part_of(key);
    if (!part || !parts[*part].sigmas) continue;
    PriorFactor prior;
    prior.key = key;
    prior.pose = graph.node(key).pose;
    prior.information = parts::information_of_sigmas(parts[*part].sigmas->data());
    graph.add_prior(prior);
  }
}

PoseGraph placed_graph(const Mission& mission, const std::vector<MissionPart>& parts,
                       const PartOfNode& part_of, const std::vector<LoopClosure>& closures) {
  PoseGraph graph;
  graph.set_planar(mission.graph.planar());
  for (Node node : mission.graph.nodes()) {
    const auto part = part_of(node.key);
    if (!part) continue;
    node.pose = se3::normalized(parts[*part].T_common_part * node.pose);
    node.covariance.reset();
    graph.add_node(node);
  }
  place_priors(mission, parts, part_of, graph);
  for (const Edge& edge : mission.graph.edges()) {
    if (graph.contains(edge.from) && graph.contains(edge.to)) graph.add_edge(edge);
  }
  for (const LoopClosure& closure : closures) graph.add_closure(closure);
  for (const RangeFactor& range : mission.graph.ranges()) {
    if (graph.contains(range.from) && graph.contains(range.to)) graph.add_range(range);
  }
  for (const GravityFactor& gravity : mission.graph.gravities()) {
    if (graph.contains(gravity.key)) graph.add_gravity(gravity);
  }
  return graph;
}

std::map<Key, Eigen::Isometry3d> placed_poses(const std::map<Key, Eigen::Isometry3d>& poses,
                                              const std::vector<MissionPart>& parts,
                                              const PartOfNode& part_of, bool move) {
  std::map<Key, Eigen::Isometry3d> out;
  for (const auto& [key, pose] : poses) {
    const auto part = part_of(key);
    if (part) out.emplace(key, move ? se3::normalized(parts[*part].T_common_part * pose) : pose);
  }
  return out;
}

}  // namespace

Mission place_parts(const Mission& mission, const std::vector<MissionPart>& parts,
                    const std::vector<LoopClosure>& closures, bool move_truth) {
  const PartOfNode part_of(mission, parts);
  Mission out = mission;
  out.graph = placed_graph(mission, parts, part_of, closures);
  std::set<std::size_t> kept;
  for (const Node& node : out.graph.nodes()) kept.insert(mission.robots.of(node.key));
  std::vector<Robot> robots;
  std::map<std::size_t, std::size_t> new_number;
  out.robot_sources.clear();
  for (std::size_t r = 0; r < mission.robots.size(); ++r) {
    const Robot& robot = mission.robots[r];
    if (kept.count(r) != 0) {
      new_number[r] = robots.size();
      robots.push_back(robot);
      if (!mission.robot_sources.empty()) out.robot_sources.push_back(mission.robot_sources[r]);
    } else if (!robot.landmarks) {
      out.problems.add_altered("robot left out: its frame is unknown", robot.name);
    }
  }
  out.robots = Robots(std::move(robots));
  out.ground_truth = placed_poses(mission.ground_truth, parts, part_of, move_truth);
  out.reference = placed_poses(mission.reference, parts, part_of, /*move=*/true);
  std::map<Key, ScanStore::Part> scans;
  for (const Key key : mission.scans->keys()) {
    if (out.graph.contains(key)) scans[key] = {mission.scans, key};
  }
  if (scans.size() != mission.scans->size()) out.scans = std::make_shared<ScanStore>(std::move(scans));
  out.radio.clear();
  for (const RadioReading& reading : mission.radio) {
    if (out.graph.contains(reading.key)) out.radio.push_back(reading);
  }
  out.beacons.clear();
  for (BeaconDrop drop : mission.beacons) {
    if (!out.graph.contains(drop.drop_key)) continue;
    drop.robot = out.robots.of(drop.drop_key);
    out.beacons.push_back(std::move(drop));
  }
  out.gaps.clear();
  for (CommunicationGap gap : mission.gaps) {
    const auto number = new_number.find(gap.robot);
    if (number == new_number.end()) continue;
    gap.robot = number->second;
    out.gaps.push_back(gap);
  }
  return out;
}

}  // namespace loopwise
