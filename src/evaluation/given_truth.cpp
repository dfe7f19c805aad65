// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/given_truth.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/trajectory.hpp>

namespace loopwise {
namespace {

constexpr double kSameStamp_s = 0.02;  // as evaluate_trajectory() of two files
constexpr double kStart_m = 10.0;      // odometry is accurate up to this path length
constexpr double kSameAngle_rad = 2.0 * 0.017453292519943295;
constexpr double kBaseline_m = 5.0;    // well above the noise of a pose
constexpr double kBodyMismatch = 0.5;  // of a displacement: 29 degrees

using NodesByKey = std::map<Key, const Node*>;

/// The robots that own key frames, with their key frames.
std::map<std::size_t, NodesByKey> nodes_by_robot(const Mission& mission) {
  std::map<std::size_t, NodesByKey> robots;
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.robots.is_landmark(node.key)) robots[mission.robots.of(node.key)].emplace(node.key, &node);
  }
  return robots;
}

struct TruthFile {
  std::string path;
  std::optional<std::size_t> robot;
};

/// "ROBOT=PATH" or a path, which may contain '=' itself.
TruthFile parse_file(const Mission& mission, const std::string& text) {
  const std::size_t at = text.find('=');
  if (at == std::string::npos || std::filesystem::exists(text)) return {text, std::nullopt};
  const std::string name = text.substr(0, at);
  std::string known;
  for (std::size_t r = 0; r < mission.robots.size(); ++r) {
    if (mission.robots[r].name == name) return {text.substr(at + 1), r};
    known += (r > 0 ? ", " : "") + mission.robots[r].name;
  }
  throw OptionError("truth \"" + text + "\": no robot is called \"" + name + "\", the robots are " + known);
}

Eigen::Isometry3d between(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, double share) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  const Eigen::Quaterniond qa(a.linear()), qb(b.linear());
  pose.linear() = qa.slerp(share, qb).normalized().toRotationMatrix();
  pose.translation() = (1.0 - share) * a.translation() + share * b.translation();
  return pose;
}

PosesByKey by_stamp(const TruthFile& file, const Trajectory& truth, const NodesByKey& nodes,
                    double max_gap_s) {
  std::vector<std::pair<std::int64_t, std::size_t>> order;
  for (std::size_t i = 0; i < truth.poses.size(); ++i) order.emplace_back(truth.stamps_ns[i], i);
  std::sort(order.begin(), order.end());
  const auto seconds = [](std::int64_t from, std::int64_t to) {
    return static_cast<double>(to - from) * 1e-9;
  };
  PosesByKey poses;
  for (const auto& [key, node] : nodes) {
    const std::int64_t stamp = node->stamp_ns;
    const auto after = std::lower_bound(order.begin(), order.end(), std::pair(stamp, std::size_t{0}));
    const bool has_after = after != order.end(), has_before = after != order.begin();
    const double gap_after = has_after ? seconds(stamp, after->first) : kSameStamp_s + 1.0;
    const double gap_before = has_before ? seconds(std::prev(after)->first, stamp) : kSameStamp_s + 1.0;
    if (std::min(gap_before, gap_after) <= kSameStamp_s) {
      poses[key] = truth.poses[(gap_after <= gap_before ? after : std::prev(after))->second];
    } else if (has_before && has_after && seconds(std::prev(after)->first, after->first) <= max_gap_s) {
      poses[key] = between(truth.poses[std::prev(after)->second], truth.poses[after->second],
                           gap_before / (gap_before + gap_after));
    }
  }
  if (poses.empty()) {
    throw InputError(file.path + ": no stamp near that of a node: the file has " +
                     std::to_string(seconds(0, order.front().first)) + " to " +
                     std::to_string(seconds(0, order.back().first)) + " s, the node " +
                     key_name(nodes.begin()->first) + " has " +
                     std::to_string(static_cast<double>(nodes.begin()->second->stamp_ns) * 1e-9) + " s");
  }
  return poses;
}

PosesByKey by_row(const TruthFile& file, const Trajectory& truth, const NodesByKey& nodes) {
  if (truth.poses.size() != nodes.size()) {
    throw InputError(file.path + ": " + std::to_string(truth.poses.size()) + " rows for " +
                     std::to_string(nodes.size()) +
                     " nodes, so rows have no nodes; give a TUM file with stamps or a g2o file");
  }
  PosesByKey poses;
  std::size_t row = 0;
  for (const auto& [key, node] : nodes) poses[key] = truth.poses[row++];
  return poses;
}

PosesByKey by_key(const TruthFile& file, const Trajectory& truth, const NodesByKey& nodes, Mission& mission) {
  PosesByKey poses;
  for (std::size_t i = 0; i < truth.keys.size(); ++i) {
    if (nodes.count(truth.keys[i]) != 0) {
      poses[truth.keys[i]] = truth.poses[i];
    } else if (!mission.graph.contains(truth.keys[i])) {
      mission.problems.add("ground truth without node", file.path + ": " + key_name(truth.keys[i]));
    }
  }
  if (poses.empty()) {
    throw InputError(file.path + ": none of its " + std::to_string(truth.keys.size()) +
                     " keys is that of a node, of which the first is " + key_name(nodes.begin()->first));
  }
  return poses;
}

PosesByKey read_truth_file(const TruthFile& file, Mission& mission, const MissionOptions& options) {
  const Trajectory truth = read_trajectory(file.path);
  if (options.strict) require_unaltered(truth.problems);
  mission.problems.add(truth.problems);
  const std::map<std::size_t, NodesByKey> robots = nodes_by_robot(mission);
  NodesByKey nodes;
  std::string names;
  for (const auto& [robot, own] : robots) {
    if (file.robot && *file.robot != robot) continue;
    nodes.insert(own.begin(), own.end());
    names += (names.empty() ? "" : ", ") + mission.robots[robot].name;
  }
  if (nodes.empty()) throw InputError(file.path + ": the mission has no node that it could be of");
  if (truth.format == TrajectoryFormat::kG2o) return by_key(file, truth, nodes, mission);
  if (!file.robot && robots.size() > 1) {
    throw InputError(file.path + ": does not say whose poses it holds, the mission has the robots " + names +
                     ": give ROBOT=FILE for each, or a g2o file with the nodes' keys");
  }
  if (truth.format != TrajectoryFormat::kTum) return by_row(file, truth, nodes);
  require_own_stamps(mission, file.path, options);
  return by_stamp(file, truth, nodes, options.truth_max_time_difference_s);
}

/// Whether the truth has the frame of the nodes, by the beginning of a robot's path.
enum class Frame { kSame, kOther, kUnknown };

/// Compares positions one by one, and the mean of the orientations, because those of a truth may be noisy.
Frame frame_of(const NodesByKey& nodes, const PosesByKey& truth) {
  const Node* last = nullptr;
  double path_m = 0.0;
  Eigen::Vector4d turns = Eigen::Vector4d::Zero();  // sum of quaternions
  for (const auto& [key, node] : nodes) {
    const Eigen::Vector3d at = node->pose.translation();
    if (last != nullptr) path_m += (at - last->pose.translation()).norm();
    if (path_m > kStart_m) break;
    last = node;
    const auto known = truth.find(key);
    if (known == truth.end()) continue;
    if ((at - known->second.translation()).norm() > 0.5 + 0.1 * path_m) return Frame::kOther;
    const Eigen::Vector4d turn =
        Eigen::Quaterniond(node->pose.linear() * known->second.linear().transpose()).coeffs();
    turns += turns.dot(turn) < 0.0 ? (-turn).eval() : turn;
  }
  if (turns.isZero(0.0)) return Frame::kUnknown;
  const double angle_rad =
      Eigen::Quaterniond(turns.normalized()).angularDistance(Eigen::Quaterniond::Identity());
  return angle_rad > kSameAngle_rad ? Frame::kOther : Frame::kSame;
}

/// Whether the truth begins at the nodes, for each robot whose beginning it has.
bool begins_with_nodes(Mission& mission, const PosesByKey& truth) {
  bool some_same = false, some_other = false;
  std::vector<std::string> unknown;
  for (const auto& [robot, nodes] : nodes_by_robot(mission)) {
    const bool has_truth = std::any_of(nodes.begin(), nodes.end(),
                                       [&](const auto& node) { return truth.count(node.first) != 0; });
    if (!has_truth) continue;
    const Frame frame = frame_of(nodes, truth);
    some_same = some_same || frame == Frame::kSame;
    some_other = some_other || frame == Frame::kOther;
    if (frame == Frame::kUnknown) unknown.push_back(mission.robots[robot].name);
  }
  const bool same = some_same && !some_other;
  for (const std::string& name : unknown) {
    mission.problems.add("truth begins late",
                         "robot " + name + ": no true pose within the first 10 m, " +
                             (same ? "assumed to be in the frame of the others" : "its frame is unknown"));
  }
  return same;
}

/// Difference of the displacements in the body frame between truth and nodes, relative to their length: the
/// median over pairs that are a baseline apart. Neither the frame nor slow drift changes it. Empty if no path
/// is long enough.
std::optional<double> body_mismatch(const Mission& mission, const PosesByKey& truth) {
  std::vector<double> mismatches;
  for (const auto& [robot, nodes] : nodes_by_robot(mission)) {
    const Node* first = nullptr;
    for (const auto& [key, node] : nodes) {
      if (truth.count(key) == 0) continue;
      if (first == nullptr) first = node;
      const Eigen::Vector3d seen = (first->pose.inverse() * node->pose).translation();
      if (seen.norm() < kBaseline_m) continue;
      const Eigen::Vector3d right = (truth.at(first->key).inverse() * truth.at(key)).translation();
      mismatches.push_back((right - seen).norm() / seen.norm());
      first = node;
    }
  }
  if (mismatches.empty()) return std::nullopt;
  const auto middle = mismatches.begin() + static_cast<std::ptrdiff_t>(mismatches.size() / 2);
  std::nth_element(mismatches.begin(), middle, mismatches.end());
  return *middle;
}

}  // namespace

void require_truth(const std::string& path, const Mission& mission) {
  if (!mission.ground_truth.empty()) return;
  throw InputError(
      path + ": has no ground truth to compare with" +
      (mission.reference.empty() ? "" : " (its own optimised poses are another program's result)") +
      "; --truth FILE gives the true poses");
}

void require_own_stamps(const Mission& mission, const std::string& file, const MissionOptions& options) {
  const auto refuse = [&](const std::string& why) {
    throw InputError(file + ": pairs by stamp, but " + why +
                     "; give a g2o file with the nodes' keys, or KITTI rows, one for each node");
  };
  if (options.start_together && mission.kind == MissionKind::kJoined)
    refuse("those of the mission were moved (--start-together): join without it");
  // In a bag the stamp is 0, which matches no pose.
  const bool is_bag = mission.kind == MissionKind::kBags || mission.kind == MissionKind::kLampZip;
  for (const Problem& problem : mission.problems.all()) {
    const bool invented =
        problem.kind == "no stamps given" || (problem.kind == "node without stamp" && !is_bag);
    if (invented) refuse("the nodes' are invented (" + to_string(problem) + "): give the recorded stamps");
  }
}

void set_truth(Mission& mission, const std::vector<std::string>& files, const MissionOptions& options) {
  if (files.empty()) return;
  validate(options);
  PosesByKey truth;
  std::string names;
  for (const std::string& text : files) {
    names += (names.empty() ? "" : ", ") + text;
    for (const auto& [key, pose] : read_truth_file(parse_file(mission, text), mission, options)) {
      if (!truth.emplace(key, pose).second)
        throw InputError(text + ": node " + key_name(key) + " has a true pose already, by another file");
    }
  }
  if (const auto mismatch = body_mismatch(mission, truth); mismatch && *mismatch > kBodyMismatch) {
    throw InputError(names + ": its orientations are not those of the nodes: over " +
                     std::to_string(static_cast<int>(kBaseline_m)) +
                     " m, displacements seen from the body differ by " +
                     std::to_string(std::lround(100.0 * *mismatch)) +
                     " %. Give poses of the body that the scans are in; positions alone are compared by "
                     "'loopwise evaluate --alignment se3'");
  }
  mission.truth_is_aligned = !begins_with_nodes(mission, truth);
  if (mission.truth_is_aligned) {
    mission.problems.add("truth in another frame",
                         names + ": aligned to the nodes, so errors are those after alignment");
    const Eigen::Isometry3d T = align(truth, poses_by_key(mission.graph), Alignment::kSe3).T_truth_estimate;
    for (auto& [key, pose] : truth) pose = se3::normalized(T * pose);
  }
  for (const Node& node : mission.graph.nodes()) {
    if (truth.count(node.key) == 0 && !mission.robots.is_landmark(node.key))
      mission.problems.add("node without ground truth", "node " + key_name(node.key));
  }
  mission.ground_truth = std::move(truth);
  mission.truth_file = names;
}

}  // namespace loopwise
