// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/trajectory.hpp>

#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

const std::vector<std::string> kFrameColumns = {"source", "x", "y", "z", "qx", "qy", "qz", "qw"};
constexpr std::size_t kLetters = 26;

std::string first_line(const std::string& contents) {
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    if (!text::trim(line).empty()) return std::string(text::trim(line));
  }
  return {};
}

/// T_common_source of each source.
std::vector<Eigen::Isometry3d> read_frames(const fs::path& file, const std::vector<std::string>& sources) {
  const std::string name = file.string();
  std::vector<std::optional<Eigen::Isometry3d>> frames(sources.size());
  const auto set = [&](std::size_t source, const Eigen::Isometry3d& pose) {
    if (frames[source])
      throw InputError(name + ": source " + text::quoted(sources[source]) + " has two frames");
    frames[source] = pose;
  };
  if (first_line(read_file(file)).rfind("source", 0) == 0) {
    const CsvTable table(file, kFrameColumns);
    for (std::size_t row = 0; row < table.size(); ++row) {
      const text::Place place{name, table.line(row)};
      const std::string& source = table.text(row, 0);
      const auto found = std::find(sources.begin(), sources.end(), source);
      if (found == sources.end()) table.fail(row, 0, text::quoted(source) + " is no source");
      if (std::count(sources.begin(), sources.end(), source) > 1) {
        table.fail(
            row, 0,
            "several sources are called " + text::quoted(source) + ": use TUM lines with their numbers");
      }
      double values[7];
      for (std::size_t i = 0; i < 7; ++i) values[i] = table.number(row, i + 1);
      set(static_cast<std::size_t>(found - sources.begin()), text::pose_of(values, place).pose);
    }
  } else {
    const Trajectory lines = read_trajectory(file, TrajectoryFormat::kTum);
    for (std::size_t i = 0; i < lines.poses.size(); ++i) {
      const std::int64_t number = lines.stamps_ns[i] / 1'000'000'000;
      if (lines.stamps_ns[i] % 1'000'000'000 != 0 || number < 0 ||
          number >= static_cast<std::int64_t>(sources.size())) {
        throw InputError(name + ": pose " + std::to_string(i) +
                         ": the first value must be the number of a source, 0 to " +
                         std::to_string(sources.size() - 1));
      }
      set(static_cast<std::size_t>(number), lines.poses[i]);
    }
  }
  std::vector<Eigen::Isometry3d> out;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    if (!frames[i]) throw InputError(name + ": no frame of source " + text::quoted(sources[i]));
    out.push_back(*frames[i]);
  }
  return out;
}

/// As programs begin that know no other frame than their own; gravity may have turned it.
bool begins_at_origin(const Mission& mission) {
  constexpr double kNear_m = 0.5;
  const std::vector<Key> first = first_nodes(mission.graph, mission.robots);
  return !first.empty() && mission.graph.node(first.front()).pose.translation().norm() < kNear_m;
}

}  // namespace

Mission join_missions(const std::vector<Mission>& missions, const MissionOptions& options) {
  if (missions.size() > kLetters) {
    throw InputError(std::to_string(missions.size()) + " sources, at most " + std::to_string(kLetters) +
                     " can be joined: a letter each");
  }
  Mission joined;
  joined.kind = MissionKind::kJoined;
  joined.path = missions.front().path;
  std::vector<std::string> sources;
  sources.reserve(missions.size());
  for (const Mission& mission : missions) sources.push_back(mission.name);
  std::vector<Eigen::Isometry3d> frames(missions.size(), Eigen::Isometry3d::Identity());
  if (!options.frames.empty()) frames = read_frames(options.frames, sources);
  joined.start_ns = missions.front().start_ns;
  for (const Mission& mission : missions) joined.start_ns = std::min(joined.start_ns, mission.start_ns);

  // Where one alone begins there, poses stand apart as a common frame has them.
  const auto at_origin = std::count_if(missions.begin(), missions.end(), begins_at_origin);

  std::vector<Robot> robots;
  std::set<std::string> names, beacons;
  std::vector<PriorFactor> priors;
  Stamps stamps;
  std::map<Key, ScanStore::Part> scans;
  for (std::size_t i = 0; i < missions.size(); ++i) {
    const Mission& mission = missions[i];
    const Eigen::Isometry3d& T = frames[i];
    if (mission.graph.planar())
      throw InputError(mission.path.string() + ": has a 2D graph: only 3D missions can be joined");
    const std::vector<Key> firsts = first_nodes(mission.graph, mission.robots);
    if (firsts.size() != 1) {
      throw InputError(mission.path.string() + ": has " + std::to_string(firsts.size()) +
                       " robots: only missions of one robot each can be joined");
    }
    const char letter = static_cast<char>('a' + i), capital = static_cast<char>('A' + i);
    std::string name = mission.name;
    for (int n = 2; names.count(name) + names.count(name + "_landmarks") != 0; ++n) {
      name = mission.name + "_" + std::to_string(n);
    }
    names.insert({name, name + "_landmarks"});
    if (options.frames.empty() && at_origin > 1 && begins_at_origin(mission)) {
      joined.problems.add(
          "joined without a frame",
          name + ": its origin is taken for that of the common frame; --frames says where it is");
    }
    robots.push_back(robot_of_character(letter, name));
    joined.name += (i > 0 ? "+" : "") + name;
    const Key first = mission.robots[mission.robots.of(firsts.front())].first;
    // Each source has seen its own landmarks: the same key in another is another.
    std::map<Key, Key> landmarks;
    for (const Node& node : mission.graph.nodes()) {
      if (mission.robots.is_landmark(node.key)) landmarks.emplace(node.key, 0);
    }
    Key seen = 0;
    for (auto& [key, as] : landmarks) as = make_key(capital, seen++);
    if (!landmarks.empty()) {
      robots.push_back(robot_of_character(capital, name + "_landmarks"));
      robots.back().landmarks = true;
    }
    const auto renamed = [&](Key key) {
      const auto landmark = landmarks.find(key);
      return landmark != landmarks.end() ? landmark->second : make_key(letter, key - first);
    };
    const std::int64_t shift = options.start_together ? joined.start_ns - mission.start_ns : 0;
    const auto shifted = [&](std::int64_t stamp_ns) {
      // The shift goes back, by up to twice the largest stamp there is.
      const bool far = stamp_ns < std::numeric_limits<std::int64_t>::min() - shift;
      if (far || !stamp_in_range(stamp_ns + shift)) {
        throw InputError(mission.path.string() + ": a stamp of " + std::to_string(stamp_ns) +
                         " ns is out of range once the mission starts with the others");
      }
      return stamp_ns + shift;
    };

    for (Node node : mission.graph.nodes()) {
      node.key = renamed(node.key);
      node.pose = se3::normalized(T * node.pose);
      stamps[node.key] = shifted(node.stamp_ns);
      joined.graph.add_node(node);
    }
    for (PriorFactor prior : mission.graph.priors()) {
      prior.key = renamed(prior.key);
      prior.pose = se3::normalized(T * prior.pose);
      priors.push_back(prior);
    }
    for (Edge edge : mission.graph.edges()) {
      edge.from = renamed(edge.from);
      edge.to = renamed(edge.to);
      joined.graph.add_edge(edge);
    }
    for (RangeFactor range : mission.graph.ranges()) {
      range.from = renamed(range.from);
      range.to = renamed(range.to);
      joined.graph.add_range(range);
    }
    // Felt in the body frame, and down is down in every frame.
    for (GravityFactor gravity : mission.graph.gravities()) {
      gravity.key = renamed(gravity.key);
      joined.graph.add_gravity(gravity);
    }
    for (const auto& [key, pose] : mission.ground_truth) {
      joined.ground_truth.emplace(renamed(key), se3::normalized(T * pose));
    }
    for (const auto& [key, pose] : mission.reference) {
      joined.reference.emplace(renamed(key), se3::normalized(T * pose));
    }
    for (const Key key : mission.scans->keys()) {
      if (mission.graph.contains(key)) scans[renamed(key)] = {mission.scans, key};
    }
    for (RadioReading reading : mission.radio) {
      reading.key = renamed(reading.key);
      joined.radio.push_back(std::move(reading));
    }
    for (BeaconDrop drop : mission.beacons) {
      if (!beacons.insert(drop.beacon).second) {
        joined.problems.add("beacon dropped twice", mission.path.string() + ": " + drop.beacon);
        continue;
      }
      drop.robot = i;
      drop.drop_key = renamed(drop.drop_key);
      drop.stamp_ns = shifted(drop.stamp_ns);
      joined.beacons.push_back(std::move(drop));
    }
    const double later_s = static_cast<double>(mission.start_ns + shift - joined.start_ns) * 1e-9;
    for (CommunicationGap gap : mission.gaps) {
      joined.gaps.push_back({i, gap.begin_s + later_s, gap.end_s + later_s});
    }
    joined.problems.add(mission.problems);
  }
  joined.robots = robots_of(joined.graph, options, Robots(std::move(robots)));
  joined.graph = with_stamps(joined.graph, stamps, priors);
  // Else each source knows the kinds of its edges, and has counted the flaws of its odometry.
  if (!options.odometry.empty() || !options.robots.empty())
    joined.problems.add(classify_edges(joined.graph, joined.robots, options));
  // The options may have divided the keys in another way.
  for (BeaconDrop& drop : joined.beacons) drop.robot = joined.robots.of(drop.drop_key);
  for (CommunicationGap& gap : joined.gaps) {
    gap.robot = joined.robots.of(make_key(static_cast<char>('a' + gap.robot), 0));
  }
  joined.scans = std::make_shared<ScanStore>(std::move(scans));
  joined.provenance_json = provenance_of(joined.kind, sources);
  return joined;
}

}  // namespace loopwise::parts
