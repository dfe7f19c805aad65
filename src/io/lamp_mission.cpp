// SPDX-License-Identifier: BSD-3-Clause
// Makes a mission of the gathered messages of a recording.
#include <algorithm>
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "lamp_messages.hpp"
#include "mission_parts.hpp"

namespace loopwise::lamp {
namespace {

/// Defaults where a covariance is not stated.
constexpr double kSightingSigmas[] = {0.5, 0.5, 0.5, 100.0, 100.0, 100.0};
constexpr double kRangeSigma = 0.5;
constexpr double kGravitySigma = 0.1;
/// Ranges from two nodes leave a circle of positions, so fewer ranges do not determine an anchor.
constexpr std::size_t kLeastRanges = 3;
/// Sigmas of a prior at the first estimate of an anchor. Beside ranges, the prior only decides on which side
/// of the path the anchor is.
constexpr double kAnchorSigmas[] = {10.0, 10.0, 10.0, 1.0, 1.0, 1.0};

/// A sigma of 0 is absent and gets a default. Other values must give a finite weight.
bool usable_sigma(double sigma) {
  return sigma == 0.0 || (sigma >= 1e-12 && sigma <= 1e12);
}

bool usable(const SeenRange& seen) {
  return seen.from != seen.to && std::isfinite(seen.range_m) && seen.range_m >= 0.0 &&
         usable_sigma(seen.sigma_m);
}

}  // namespace

/// Names of robots by their characters, from the first words of topics. Topics of the base station usually
/// have nodes of several robots. If they have only one robot, the robot's own topic takes precedence.
std::map<char, std::string> Gatherer::robot_names() const {
  std::map<char, std::vector<std::string>> candidates;
  for (const auto& [name, characters] : characters_) {
    if (!name.empty() && characters.size() == 1) candidates[*characters.begin()].push_back(name);
  }
  std::map<char, std::string> names;
  for (auto& [character, words] : candidates) {
    if (words.size() > 1) {
      words.erase(std::remove_if(words.begin(), words.end(),
                                 [](const std::string& word) { return word.rfind("base", 0) == 0; }),
                  words.end());
    }
    if (words.size() == 1) names[character] = words.front();
  }
  return names;
}

std::optional<std::size_t> Gatherer::robot_named(const Robots& robots, const std::string& text) const {
  const auto names = robot_names();
  for (std::size_t r = 0; r < robots.size(); ++r) {
    const auto name = names.find(key_character(robots[r].first));
    if (robots[r].name == text || (name != names.end() && name->second == text)) return r;
  }
  return std::nullopt;
}

void Gatherer::finish(Mission& mission, const std::string& name) const {
  PoseGraph graph;
  for (const auto& [key, seen] : graph_.nodes) {
    if (!seen.pose) {
      problems_.add_altered("node without usable pose", seen.where + ": " + key_name(key));
      continue;
    }
    if (!seen.has_stamp) problems_.add("node without stamp", seen.where + ": " + key_name(key));
    Node node;
    node.key = key;
    node.pose = *seen.pose;
    graph.add_node(node);
  }
  if (graph.empty()) throw InputError(name + ": has no pose graph with a node");
  const Landmarks landmarks = held_landmarks(graph);
  std::set<char> characters;
  for (const auto& [key, pose] : landmarks.poses) {
    Node node;
    node.key = key;
    node.pose = pose;
    graph.add_node(node);
    characters.insert(key_character(key));
  }

  Robots robots = Robots::from_keys(graph.keys());
  const auto names = robot_names();
  std::vector<Robot> named = robots.all();
  for (Robot& robot : named) {
    const auto own = names.find(key_character(robot.first));
    const bool taken = own != names.end() && std::any_of(named.begin(), named.end(), [&](const Robot& other) {
                         return other.name == own->second;
                       });
    if (own != names.end() && !taken) robot.name = own->second;
  }
  mission.robots =
      parts::robots_of(graph, options_, parts::with_landmarks(Robots(std::move(named)), characters));
  mission.graph = std::move(graph);
  add_factors(mission, name, landmarks);
  parts::check_stamps(mission);
  add_radio_to(mission);
  add_truth_to(mission);
}

Gatherer::Landmarks Gatherer::held_landmarks(const PoseGraph& key_frames) const {
  Landmarks held;
  const auto pose_of_node = [&](Key key) -> std::optional<Eigen::Isometry3d> {
    if (key_frames.contains(key)) return key_frames.node(key).pose;
    const auto landmark = held.poses.find(key);
    return landmark == held.poses.end() ? std::nullopt : std::optional(landmark->second);
  };
  const auto first_pose = [&](Key key) {
    const auto seen = graph_.landmarks.find(key);
    return seen == graph_.landmarks.end() ? std::nullopt : seen->second.pose;
  };
  for (const SeenFactor& prior : graph_.priors) {
    if (is_landmark(prior.from) && prior.pose) {
      held.poses.emplace(prior.from, first_pose(prior.from).value_or(*prior.pose));
    }
  }
  const auto hold = [&](Key key, const Eigen::Isometry3d& sighted) {
    const Eigen::Isometry3d pose = first_pose(key).value_or(se3::normalized(sighted));
    return pose.matrix().allFinite() && held.poses.emplace(key, pose).second;
  };
  // A landmark may be seen from another landmark that a key frame sees.
  const auto spread = [&] {
    for (bool changed = true; changed;) {
      changed = false;
      for (const auto* list : {&graph_.sightings, &graph_.closures}) {
        for (const SeenFactor& seen : *list) {
          if (!seen.pose) continue;
          const auto from = pose_of_node(seen.from), to = pose_of_node(seen.to);
          if (from && !to && is_landmark(seen.to)) {
            changed = hold(seen.to, *from * *seen.pose) || changed;
          } else if (to && !from && is_landmark(seen.from)) {
            changed = hold(seen.from, *to * seen.pose->inverse()) || changed;
          }
        }
      }
    }
  };
  spread();
  std::map<Key, std::set<Key>> ranged;
  for (const SeenRange& range : graph_.ranges) {
    if (!usable(range)) continue;
    if (is_landmark(range.to) && pose_of_node(range.from)) ranged[range.to].insert(range.from);
    if (is_landmark(range.from) && pose_of_node(range.to)) ranged[range.from].insert(range.to);
  }
  for (const auto& [key, nodes] : ranged) {
    const auto pose = first_pose(key);
    if (!pose || nodes.size() < kLeastRanges || !held.poses.emplace(key, *pose).second) continue;
    held.by_ranges.push_back(key);
  }
  spread();
  for (const auto& [key, seen] : graph_.landmarks) {
    if (held.poses.count(key) != 0) continue;
    const auto nodes = ranged.find(key);
    problems_.add_altered(
        "landmark left out",
        seen.where + ": " + key_name(key) + ", " +
            (seen.pose ? "not sighted, ranged from " : "without usable pose, ranged from ") +
            std::to_string(nodes == ranged.end() ? 0 : nodes->second.size()) + " of the " +
            std::to_string(kLeastRanges) + " nodes that are needed");
  }
  return held;
}

void Gatherer::add_ranges(PoseGraph& graph) const {
  for (const SeenRange& seen : graph_.ranges) {
    const auto left_out = [&](Key key) { return is_landmark(key) && !graph.contains(key); };
    if (!usable(seen)) {
      problems_.add_altered("unusable range factor", seen.where + ": " + std::to_string(seen.range_m) +
                                                         " m, sigma " + std::to_string(seen.sigma_m) + " m");
    } else if (left_out(seen.from) || left_out(seen.to)) {
      problems_.add_altered("range factor of a landmark left out", seen.where);
    } else if (!graph.contains(seen.from) || !graph.contains(seen.to)) {
      problems_.add_altered("edge without node", seen.where);
    } else {
      if (seen.sigma_m == 0.0) problems_.add_altered("covariance absent", seen.where);
      graph.add_range({seen.from, seen.to, seen.range_m, seen.sigma_m == 0.0 ? kRangeSigma : seen.sigma_m});
    }
  }
}

void Gatherer::add_gravity(PoseGraph& graph) const {
  for (const SeenGravity& seen : graph_.gravities) {
    const double length = seen.direction.norm();
    if (!graph.contains(seen.key)) {
      problems_.add_altered("edge without node", seen.where);
    } else if (!std::isfinite(length) || !(length > 0.0) || !usable_sigma(seen.sigma_rad)) {
      problems_.add_altered("unusable gravity factor", seen.where);
    } else if (parts::points_up(graph, seen.key, seen.direction)) {
      problems_.add_altered(parts::kGravityUp, seen.where);
    } else {
      if (seen.sigma_rad == 0.0) problems_.add_altered("covariance absent", seen.where);
      GravityFactor gravity;
      gravity.key = seen.key;
      gravity.direction = seen.direction;
      gravity.sigma_rad = seen.sigma_rad == 0.0 ? kGravitySigma : seen.sigma_rad;
      graph.add_gravity(gravity);
    }
  }
}

parts::Stamps Gatherer::stamps_of(const PoseGraph& graph, const Robots& robots) const {
  parts::Stamps stamps;
  for (const Key key : parts::key_frames(graph, robots)) {
    // A node that is a landmark in the messages may be a key frame according to the options.
    const auto node = graph_.nodes.find(key), landmark = graph_.landmarks.find(key);
    if (node != graph_.nodes.end()) {
      stamps[key] = node->second.stamp_ns;
    } else if (landmark != graph_.landmarks.end()) {
      stamps[key] = landmark->second.stamp_ns;
    }
  }
  // The stamp of a landmark is not before the first node that saw it.
  for (const auto& [key, stamp] : parts::first_sightings(graph, robots, stamps)) {
    const auto seen = graph_.landmarks.find(key);
    const bool given = seen != graph_.landmarks.end() && seen->second.has_stamp;
    stamps[key] = given ? std::max(stamp, seen->second.stamp_ns) : stamp;
  }
  return stamps;
}

void Gatherer::add_factors(Mission& mission, const std::string& name, const Landmarks& landmarks) const {
  PoseGraph& graph = mission.graph;
  const auto in_graph = [&](const SeenFactor& seen) {
    if (!graph.contains(seen.from) || !graph.contains(seen.to)) {
      problems_.add_altered("edge without node", seen.where);
    } else if (!seen.pose) {
      problems_.add_altered("edge without pose", seen.where);
    } else {
      return true;
    }
    return false;
  };
  const auto add_edges = [&](const std::vector<SeenFactor>& list, auto&& otherwise) {
    for (const SeenFactor& seen : list) {
      if (!in_graph(seen)) continue;
      Edge edge;
      edge.from = seen.from;
      edge.to = seen.to;
      edge.T_from_to = *seen.pose;
      if (!seen.information) problems_.add_altered("covariance absent", seen.where);
      edge.information = seen.information ? *seen.information : otherwise(*seen.pose);
      try {
        graph.add_edge(edge);
      } catch (const InputError& error) {
        problems_.add_altered("unusable edge", seen.where + ": " + error.what());
      }
    }
  };
  const Neighbours neighbours(graph, mission.robots);
  for (const SeenFactor& seen : graph_.odometry) {
    if (graph.contains(seen.from) && graph.contains(seen.to) && !neighbours(seen.from, seen.to)) {
      problems_.add("odometry not between consecutive nodes", seen.where);
    }
  }
  add_edges(graph_.odometry, [&](const Eigen::Isometry3d& T) { return odometry_information(T, options_); });
  add_edges(graph_.closures, [](const Eigen::Isometry3d&) { return parts::closure_information(); });
  add_edges(graph_.sightings,
            [](const Eigen::Isometry3d&) { return parts::information_of_sigmas(kSightingSigmas); });
  add_ranges(graph);
  add_gravity(graph);

  std::vector<PriorFactor> priors;
  for (const SeenFactor& seen : graph_.priors) {
    if (!in_graph(seen)) continue;
    if (!seen.information) problems_.add_altered("covariance absent", seen.where);
    priors.push_back(
        {seen.from, *seen.pose,
         seen.information ? *seen.information : parts::information_of_sigmas(options_.prior_sigmas.data())});
  }
  parts::complete_priors(graph, mission.robots, options_, name, priors, problems_);
  for (const Key key : landmarks.by_ranges) {
    priors.push_back({key, graph.node(key).pose, parts::information_of_sigmas(kAnchorSigmas)});
    problems_.add_altered("landmark with ranges only, given a prior", name + ": " + key_name(key));
  }
  graph =
      parts::assemble(graph, stamps_of(graph, mission.robots), priors, mission.robots, options_, problems_);
}

void Gatherer::add_radio_to(Mission& mission) const {
  for (const auto& [beacon, drop] : drops_) {
    if (!mission.graph.contains(drop.key)) {
      problems_.add("beacon drop without node", beacon + " at " + key_name(drop.key));
      continue;
    }
    mission.beacons.push_back({beacon, mission.robots.of(drop.key), drop.key, drop.stamp_ns});
  }

  std::vector<std::vector<std::pair<std::int64_t, Key>>> paths(mission.robots.size());
  for (const Node& node : mission.graph.nodes()) {
    paths[mission.robots.of(node.key)].emplace_back(node.stamp_ns, node.key);
  }
  for (auto& path : paths) std::sort(path.begin(), path.end());
  // A robot passes a node once, so the reading nearest in time is used.
  struct Nearest {
    std::int64_t distance_ns;
    const Reading* reading;
  };
  std::map<std::pair<Key, std::string>, Nearest> chosen;
  for (const Reading& reading : readings_) {
    if (!drops_.empty() && drops_.count(reading.beacon) == 0) {
      problems_.add("radio reading of a beacon that was not dropped", reading.beacon);
      continue;
    }
    const auto robot = robot_named(mission.robots, reading.robot);
    if (!robot || paths[*robot].empty()) {
      problems_.add("radio reading of an unknown robot", reading.robot);
      continue;
    }
    const auto& path = paths[*robot];
    auto node = std::lower_bound(path.begin(), path.end(), std::make_pair(reading.stamp_ns, Key{0}));
    const auto distance = [&](auto at) { return std::abs(at->first - reading.stamp_ns); };
    if (node == path.end() || (node != path.begin() && distance(std::prev(node)) <= distance(node))) --node;
    const auto [nearest, is_new] =
        chosen.emplace(std::make_pair(node->second, reading.beacon), Nearest{distance(node), &reading});
    if (is_new) continue;
    problems_.add("repeated radio reading of a node, the nearest in time is used",
                  key_name(node->second) + ", " + reading.beacon);
    if (distance(node) < nearest->second.distance_ns) nearest->second = {distance(node), &reading};
  }
  for (const auto& [which, nearest] : chosen) {
    for (std::size_t i = 0; i < nearest.reading->receive_dbm.size(); ++i) {
      mission.radio.push_back({which.first, which.second, nearest.reading->transmit_dbm, std::to_string(i),
                               nearest.reading->receive_dbm[i]});
    }
  }
}

std::optional<std::size_t> Gatherer::robot_of_truth(const Robots& robots, const Truth& truth) const {
  for (const std::string& source : truth.source) {
    if (const auto robot = robot_named(robots, first_word(source))) return robot;
    for (std::size_t r = 0; r < robots.size(); ++r) {
      if (robots[r].landmarks) continue;
      // For example, source "husky3_odom.bag" for the robot "husky3".
      const std::string& name = robots[r].name;
      const bool begins =
          name.size() > 1 && source.rfind(name, 0) == 0 &&
          (source.size() == name.size() || !std::isalnum(static_cast<unsigned char>(source[name.size()])));
      if (begins) return r;
    }
  }
  return std::nullopt;
}

void Gatherer::add_truth_to(Mission& mission) const {
  if (truths_.empty()) return;
  const double tolerance_s = std::min(options_.truth_max_time_difference_s, 1e9);
  const auto tolerance_ns = static_cast<std::int64_t>(std::llround(tolerance_s * 1e9));
  const auto names = robot_names();
  std::set<std::size_t> own;  // robots, without landmarks
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.robots.is_landmark(node.key)) own.insert(mission.robots.of(node.key));
  }
  // A topic may continue in another bag.
  std::set<std::string> topics;
  for (const Truth& truth : truths_) topics.insert(truth.source.front());
  struct Path {
    std::size_t robot;
    std::string topic;
    std::vector<std::pair<std::int64_t, Eigen::Isometry3d>> poses;
  };
  std::vector<Path> paths;
  for (const Truth& truth : truths_) {
    std::optional<std::size_t> robot = robot_of_truth(mission.robots, truth);
    // Without any name, a single truth belongs to the only robot.
    const bool nameless = names.empty() || first_word(truth.source.front()).empty();
    if (!robot && nameless && own.size() == 1 && topics.size() == 1) robot = *own.begin();
    if (!robot) {
      problems_.add("ground truth of an unknown robot", truth.source.front());
      continue;
    }
    auto path = std::find_if(paths.begin(), paths.end(), [&](const Path& other) {
      return other.robot == *robot && other.topic == truth.source.front();
    });
    if (path == paths.end()) path = paths.insert(paths.end(), Path{*robot, truth.source.front(), {}});
    path->poses.insert(path->poses.end(), truth.poses.begin(), truth.poses.end());
  }
  std::map<Key, Eigen::Isometry3d> poses;
  for (Path& path : paths) {
    auto& sorted = path.poses;
    std::stable_sort(sorted.begin(), sorted.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    for (const Node& node : mission.graph.nodes()) {
      if (sorted.empty() || mission.robots.of(node.key) != path.robot) continue;
      auto at = std::lower_bound(sorted.begin(), sorted.end(), node.stamp_ns,
                                 [](const auto& pose, std::int64_t stamp) { return pose.first < stamp; });
      const auto distance = [&](auto pose) { return std::abs(pose->first - node.stamp_ns); };
      if (at == sorted.end() || (at != sorted.begin() && distance(std::prev(at)) <= distance(at))) --at;
      if (distance(at) <= tolerance_ns) poses.emplace(node.key, at->second);
    }
  }
  parts::set_ground_truth(mission, std::move(poses));
}

}  // namespace loopwise::lamp
