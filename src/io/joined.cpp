// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
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

constexpr std::size_t kRobotLetters = 26;

std::string first_line(const std::string& contents) {
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    if (!text::trim(line).empty()) return std::string(text::trim(line));
  }
  return {};
}

/// Pose of a source's frame in the common frame.
struct SourceFrame {
  Eigen::Isometry3d T_common_source = Eigen::Isometry3d::Identity();
  /// Sigmas of the source's first key frame: x y z roll pitch yaw. If absent, the source's priors are
  /// unchanged.
  std::optional<std::array<double, 6>> sigmas;
};

/// A possible header of a file of frames.
struct FrameColumns {
  std::vector<std::string> names;
  bool yaw_alone;  ///< Otherwise a quaternion.
  bool sigmas;
};

/// The known header that the first line of a file has; the plain one if no header matches.
const FrameColumns& frame_columns(const std::string& header) {
  static const std::vector<FrameColumns> kKnown = {
      {{"source", "x", "y", "z", "qx", "qy", "qz", "qw"}, false, false},
      {{"source", "x", "y", "z", "qx", "qy", "qz", "qw", "sx", "sy", "sz", "srx", "sry", "srz"}, false, true},
      {{"source", "x", "y", "z", "yaw"}, true, false},
      {{"source", "x", "y", "z", "yaw", "sx", "sy", "sz", "syaw"}, true, true}};
  std::string plain;
  for (const char c : header) {
    if (c != ' ' && c != '\t' && c != '"') plain += c;
  }
  for (const FrameColumns& columns : kKnown) {
    std::string names;
    for (const std::string& name : columns.names) names += (names.empty() ? "" : ",") + name;
    if (names == plain) return columns;
  }
  return kKnown.front();
}

/// Reads the frame in a row from its second column.
SourceFrame frame_of_row(const CsvTable& table, std::size_t row, const FrameColumns& columns,
                         const text::Place& place, const MissionOptions& options) {
  std::vector<double> values;
  for (std::size_t i = 1; i < columns.names.size(); ++i) values.push_back(table.number(row, i));
  SourceFrame frame;
  const std::size_t numbers = columns.yaw_alone ? 4 : 7;
  if (columns.yaw_alone) {
    constexpr double kTurn_rad = 6.2832;
    if (std::abs(values[3]) > kTurn_rad)
      table.fail(row, 4, "must be in rad, at most 6.2832, found " + table.text(row, 4));
    frame.T_common_source.linear() =
        Eigen::AngleAxisd(values[3], Eigen::Vector3d::UnitZ()).toRotationMatrix();
    frame.T_common_source.translation() = Eigen::Vector3d(values[0], values[1], values[2]);
  } else {
    frame.T_common_source = text::pose_of(values.data(), place).pose;
  }
  if (!columns.sigmas) return frame;
  for (std::size_t i = numbers; i < values.size(); ++i) {
    if (!(values[i] > 0.0)) table.fail(row, i + 1, "a sigma must be > 0, found " + table.text(row, i + 1));
  }
  std::array<double, 6> sigmas{};
  for (std::size_t i = 0; i < 3; ++i) sigmas[i] = values[numbers + i];
  for (std::size_t i = 3; i < 6; ++i)
    sigmas[i] = columns.yaw_alone ? options.prior_sigmas[i] : values[numbers + i];
  if (columns.yaw_alone) sigmas[5] = values[numbers + 3];
  frame.sigmas = sigmas;
  return frame;
}

std::vector<SourceFrame> read_frames(const MissionOptions& options, const std::vector<std::string>& sources) {
  const fs::path file = options.frames;
  const std::string name = file.string();
  std::vector<std::optional<SourceFrame>> frames(sources.size());
  const auto set = [&](std::size_t source, const SourceFrame& frame) {
    if (frames[source])
      throw InputError(name + ": source " + text::quoted(sources[source]) + " has two frames");
    frames[source] = frame;
  };
  const std::string header = first_line(read_file(file));
  if (header.rfind("source", 0) == 0) {
    const FrameColumns& columns = frame_columns(header);
    const CsvTable table(file, columns.names);
    for (std::size_t row = 0; row < table.size(); ++row) {
      const text::Place place{name, table.line(row)};
      const std::string& source = table.text(row, 0);
      const auto found = std::find(sources.begin(), sources.end(), source);
      if (found == sources.end()) table.fail(row, 0, text::quoted(source) + " is not the name of a source");
      if (std::count(sources.begin(), sources.end(), source) > 1) {
        table.fail(
            row, 0,
            "several sources are called " + text::quoted(source) + ": use TUM lines with their numbers");
      }
      set(static_cast<std::size_t>(found - sources.begin()),
          frame_of_row(table, row, columns, place, options));
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
      set(static_cast<std::size_t>(number), {lines.poses[i], std::nullopt});
    }
  }
  std::vector<SourceFrame> out;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    if (!frames[i]) throw InputError(name + ": no frame of source " + text::quoted(sources[i]));
    out.push_back(*frames[i]);
  }
  return out;
}

/// Whether a mission begins at the origin, as in programs that use only their own frame. Gravity may have
/// rotated its first pose.
bool begins_at_origin(const Mission& mission) {
  constexpr double kNear_m = 0.5;
  const std::vector<Key> first = first_nodes(mission.graph, mission.robots);
  return !first.empty() && mission.graph.node(first.front()).pose.translation().norm() < kNear_m;
}

/// Makes one mission of several, source by source.
class Joiner {
 public:
  Joiner(const std::vector<Mission>& missions, const MissionOptions& options)
      : missions_(missions), options_(options), frames_(missions.size()) {
    joined_.kind = MissionKind::kJoined;
    joined_.path = missions.front().path;
    for (const Mission& mission : missions) sources_.push_back(mission.name);
    if (!options.frames.empty()) frames_ = read_frames(options, sources_);
    joined_.start_ns = missions.front().start_ns;
    for (const Mission& mission : missions) joined_.start_ns = std::min(joined_.start_ns, mission.start_ns);
    // Problems of the frame are reported only if several missions begin at the origin; otherwise a common
    // frame is likely.
    at_origin_ = std::count_if(missions.begin(), missions.end(), begins_at_origin);
  }

  Mission join() {
    if (!options_.start_together) report_long_gaps();
    for (std::size_t source = 0; source < missions_.size(); ++source) add(source);
    joined_.robots = robots_of(joined_.graph, options_, Robots(std::move(robots_)));
    joined_.graph = with_stamps(joined_.graph, stamps_, priors_);
    // Without these options, the sources have already classified their edges and counted problems of the
    // odometry.
    if (!options_.odometry.empty() || !options_.robots.empty())
      joined_.problems.add(classify_edges(joined_.graph, joined_.robots, options_));
    // The options may have assigned the keys to other robots.
    for (BeaconDrop& drop : joined_.beacons) drop.robot = joined_.robots.of(drop.drop_key);
    for (CommunicationGap& gap : joined_.gaps)
      gap.robot = joined_.robots.of(make_key(static_cast<char>('a' + gap.robot), 0));
    for (const Robot& robot : joined_.robots.all()) {
      const char letter = key_character(robot.first);
      const auto index = static_cast<std::size_t>(letter - (robot.landmarks ? 'A' : 'a'));
      joined_.robot_sources.push_back(index < source_of_letter_.size() ? source_of_letter_[index] : 0);
    }
    joined_.scans = std::make_shared<ScanStore>(std::move(scans_));
    joined_.provenance_json = provenance_of(joined_.kind, sources_);
    return std::move(joined_);
  }

 private:
  void report_long_gaps();
  void add(std::size_t source);
  void name_robots(std::size_t source);
  void add_graph(const Mission& mission, const SourceFrame& frame);
  void add_rest(const Mission& mission);
  std::string unique_name(const std::string& wanted);
  [[nodiscard]] Key renamed(Key key) const;
  [[nodiscard]] std::int64_t shifted(const Mission& mission, std::int64_t stamp_ns) const;

  const std::vector<Mission>& missions_;
  const MissionOptions& options_;
  std::vector<SourceFrame> frames_;
  std::vector<std::string> sources_;
  std::ptrdiff_t at_origin_ = 0;
  Mission joined_;
  std::vector<Robot> robots_;
  std::set<std::string> names_, beacons_;
  std::vector<PriorFactor> priors_;
  Stamps stamps_;
  std::map<Key, ScanStore::Part> scans_;
  std::vector<std::size_t> source_of_letter_;

  // State of the source that is being added.
  std::map<std::size_t, std::size_t> letter_of_robot_;
  std::map<Key, Key> landmarks_;
  const Mission* source_ = nullptr;
};

/// Sources of different days make a mission of days in which nothing happens.
void Joiner::report_long_gaps() {
  constexpr double kDay_ns = 86400e9;
  struct Span {
    double first_ns, last_ns;
    std::string path;
  };
  std::vector<Span> spans;
  for (const Mission& mission : missions_) {
    std::int64_t last = mission.start_ns;
    for (const Node& node : mission.graph.nodes()) last = std::max(last, node.stamp_ns);
    spans.push_back(
        {static_cast<double>(mission.start_ns), static_cast<double>(last), mission.path.string()});
  }
  std::stable_sort(spans.begin(), spans.end(),
                   [](const Span& a, const Span& b) { return a.first_ns < b.first_ns; });
  double end_ns = spans.front().last_ns;
  for (const Span& span : spans) {
    if (span.first_ns - end_ns > kDay_ns) {
      joined_.problems.add("source recorded more than a day after the others",
                           span.path + ", " +
                               std::to_string(std::lround((span.first_ns - end_ns) / kDay_ns)) +
                               " days; --start-together lets all begin at the same time");
    }
    end_ns = std::max(end_ns, span.last_ns);
  }
}

std::string Joiner::unique_name(const std::string& wanted) {
  std::string name = wanted;
  for (int n = 2; names_.count(name) + names_.count(name + "_landmarks") != 0; ++n)
    name = wanted + "_" + std::to_string(n);
  names_.insert({name, name + "_landmarks"});
  return name;
}

/// Assigns a letter to each robot, and the capital letter of the source's first robot to its landmarks.
void Joiner::name_robots(std::size_t source) {
  const Mission& mission = missions_[source];
  const std::vector<Key> firsts = first_nodes(mission.graph, mission.robots);
  if (firsts.empty()) throw InputError(mission.path.string() + ": has no key frames");
  const std::size_t first_letter = source_of_letter_.size();
  if (first_letter + firsts.size() > kRobotLetters) {
    throw InputError("more than " + std::to_string(kRobotLetters) +
                     " robots cannot be joined, because each needs a letter");
  }
  letter_of_robot_.clear();
  landmarks_.clear();
  const std::string whole = unique_name(mission.name);
  joined_.name += (source > 0 ? "+" : "") + whole;
  for (const Key first : firsts) {
    const std::size_t robot = mission.robots.of(first), letter = source_of_letter_.size();
    letter_of_robot_[robot] = letter;
    source_of_letter_.push_back(source);
    const std::string name =
        firsts.size() == 1 ? whole : unique_name(whole + "_" + mission.robots[robot].name);
    robots_.push_back(robot_of_character(static_cast<char>('a' + letter), name));
  }
  // Each source has its own landmarks: the same key in another source is another landmark.
  for (const Node& node : mission.graph.nodes()) {
    if (mission.robots.is_landmark(node.key)) landmarks_.emplace(node.key, 0);
  }
  const char capital = static_cast<char>('A' + first_letter);
  Key seen = 0;
  for (auto& [key, as] : landmarks_) as = make_key(capital, seen++);
  if (!landmarks_.empty()) {
    robots_.push_back(robot_of_character(capital, whole + "_landmarks"));
    robots_.back().landmarks = true;
  }
}

Key Joiner::renamed(Key key) const {
  const auto landmark = landmarks_.find(key);
  if (landmark != landmarks_.end()) return landmark->second;
  const std::size_t robot = source_->robots.of(key);
  const Key first = source_->robots[robot].first;
  return make_key(static_cast<char>('a' + letter_of_robot_.at(robot)), key - first);
}

std::int64_t Joiner::shifted(const Mission& mission, std::int64_t stamp_ns) const {
  // The shift is negative or zero, and can reach twice the largest stamp.
  const std::int64_t shift = options_.start_together ? joined_.start_ns - mission.start_ns : 0;
  const bool far = stamp_ns < std::numeric_limits<std::int64_t>::min() - shift;
  if (far || !stamp_in_range(stamp_ns + shift)) {
    throw InputError(
        mission.path.string() + ": a stamp of " + std::to_string(stamp_ns) +
        " ns is out of range after start_together shifts the mission to the start of the others");
  }
  return stamp_ns + shift;
}

void Joiner::add_graph(const Mission& mission, const SourceFrame& frame) {
  const Eigen::Isometry3d& T = frame.T_common_source;
  for (Node node : mission.graph.nodes()) {
    node.key = renamed(node.key);
    node.pose = se3::normalized(T * node.pose);
    stamps_[node.key] = shifted(mission, node.stamp_ns);
    joined_.graph.add_node(node);
  }
  if (frame.sigmas) {
    for (const Key first : first_nodes(mission.graph, mission.robots)) {
      const Key key = renamed(first);
      priors_.push_back({key, joined_.graph.node(key).pose, information_of_sigmas(frame.sigmas->data())});
    }
    for (const PriorFactor& prior : mission.graph.priors()) {
      const std::vector<Key> firsts = first_nodes(mission.graph, mission.robots);
      if (std::find(firsts.begin(), firsts.end(), prior.key) == firsts.end())
        joined_.problems.add("prior left out, because its source's frame has sigmas",
                             mission.path.string() + ": node " + key_name(prior.key));
    }
  } else {
    for (PriorFactor prior : mission.graph.priors()) {
      prior.key = renamed(prior.key);
      prior.pose = se3::normalized(T * prior.pose);
      priors_.push_back(prior);
    }
  }
  for (Edge edge : mission.graph.edges()) {
    edge.from = renamed(edge.from);
    edge.to = renamed(edge.to);
    joined_.graph.add_edge(edge);
  }
  for (RangeFactor range : mission.graph.ranges()) {
    range.from = renamed(range.from);
    range.to = renamed(range.to);
    joined_.graph.add_range(range);
  }
  // Gravity is measured in the body frame, and all frames agree on the direction down.
  for (GravityFactor gravity : mission.graph.gravities()) {
    gravity.key = renamed(gravity.key);
    joined_.graph.add_gravity(gravity);
  }
  for (const auto& [key, pose] : mission.ground_truth)
    joined_.ground_truth.emplace(renamed(key), se3::normalized(T * pose));
  for (const auto& [key, pose] : mission.reference)
    joined_.reference.emplace(renamed(key), se3::normalized(T * pose));
}

void Joiner::add_rest(const Mission& mission) {
  for (const Key key : mission.scans->keys()) {
    if (mission.graph.contains(key)) scans_[renamed(key)] = {mission.scans, key};
  }
  for (RadioReading reading : mission.radio) {
    reading.key = renamed(reading.key);
    joined_.radio.push_back(std::move(reading));
  }
  for (BeaconDrop drop : mission.beacons) {
    if (!beacons_.insert(drop.beacon).second) {
      joined_.problems.add("beacon dropped twice", mission.path.string() + ": " + drop.beacon);
      continue;
    }
    drop.drop_key = renamed(drop.drop_key);
    drop.stamp_ns = shifted(mission, drop.stamp_ns);
    joined_.beacons.push_back(std::move(drop));
  }
  const std::int64_t shift = options_.start_together ? joined_.start_ns - mission.start_ns : 0;
  const double later_s = static_cast<double>(mission.start_ns + shift - joined_.start_ns) * 1e-9;
  for (const CommunicationGap& gap : mission.gaps) {
    const auto letter = letter_of_robot_.find(gap.robot);
    if (letter == letter_of_robot_.end()) continue;  // of a robot without nodes
    joined_.gaps.push_back({letter->second, gap.begin_s + later_s, gap.end_s + later_s});
  }
}

void Joiner::add(std::size_t source) {
  const Mission& mission = missions_[source];
  source_ = &mission;
  if (mission.graph.planar())
    throw InputError(mission.path.string() + ": has a 2D graph: only 3D missions can be joined");
  name_robots(source);
  if (options_.frames.empty() && at_origin_ > 1 && begins_at_origin(mission)) {
    joined_.problems.add(kWithoutFrame,
                         mission.name +
                             ": its origin is assumed to be that of the common frame; --frames auto " +
                             "estimates it from the scans, --frames FILE gives it");
  }
  add_graph(mission, frames_[source]);
  add_rest(mission);
  joined_.problems.add(mission.problems);
}

}  // namespace

Mission join_missions(const std::vector<Mission>& missions, const MissionOptions& options) {
  return Joiner(missions, options).join();
}

}  // namespace loopwise::parts
