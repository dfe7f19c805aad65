// SPDX-License-Identifier: BSD-3-Clause
#include "mission_parts.hpp"
#include "bag_files.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <fstream>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

const std::set<std::string> kTruthFolders = {"ground_truth", "gt", "groundtruth"};
const std::set<std::string> kTruthFiles = {"ground_truth.g2o", "gt.g2o", "groundtruth.g2o"};

}  // namespace

bool is_landmark_character(char character) {
  return (character >= 'A' && character <= 'Z') || character == 'u';
}

Robots with_landmarks(const Robots& robots, const std::set<char>& characters) {
  std::map<char, std::string> names;
  std::set<std::string> taken;
  for (const Robot& robot : robots.all()) {
    names[key_character(robot.first)] = robot.name;
    if (characters.count(key_character(robot.first)) == 0) taken.insert(robot.name);
  }
  std::vector<Robot> marked = robots.all();
  for (Robot& robot : marked) {
    const char character = key_character(robot.first);
    if (characters.count(character) == 0) continue;
    robot.landmarks = true;
    const auto owner = names.find(static_cast<char>(std::tolower(static_cast<unsigned char>(character))));
    std::string name = "uwb_anchors";
    if (character != 'u') name = (owner != names.end() ? owner->second : robot.name) + "_artifacts";
    if (taken.insert(name).second) robot.name = name;
  }
  return Robots(std::move(marked));
}

std::vector<Key> key_frames(const PoseGraph& graph, const Robots& robots) {
  std::vector<Key> keys;
  for (const Node& node : graph.nodes()) {
    if (!robots.is_landmark(node.key)) keys.push_back(node.key);
  }
  std::sort(keys.begin(), keys.end());
  return keys;
}

Stamps first_sightings(const PoseGraph& graph, const Robots& robots, const Stamps& stamps) {
  Stamps first;
  const auto see = [&](Key landmark, Key from) {
    const auto stamp = stamps.find(from);
    if (!robots.is_landmark(landmark) || robots.is_landmark(from) || stamp == stamps.end()) return;
    const auto [known, is_new] = first.emplace(landmark, stamp->second);
    if (!is_new) known->second = std::min(known->second, stamp->second);
  };
  const auto tie = [&](Key a, Key b) {
    see(a, b);
    see(b, a);
  };
  for (const Edge& edge : graph.edges()) tie(edge.from, edge.to);
  for (const RangeFactor& range : graph.ranges()) tie(range.from, range.to);
  return first;
}

void complete_priors(const PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                     const std::string& name, std::vector<PriorFactor>& priors, Problems& problems) {
  std::set<std::size_t> with_prior;
  for (const PriorFactor& prior : priors) with_prior.insert(robots.of(prior.key));
  const std::vector<Key> firsts = first_nodes(graph, robots);
  for (const Key key : firsts) {
    if (with_prior.count(robots.of(key)) != 0) continue;
    priors.push_back(default_prior(graph, key, options));
    // The frame of a single robot is its own, so no guess is involved.
    if (firsts.size() > 1) problems.add("no prior given", name + ": node " + key_name(key) + " gets one");
  }
}

void complete_stamps(const PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                     const std::string& name, Stamps& stamps, Problems& problems) {
  const double interval_ns = std::min(options.node_interval_s, 1e9) * 1e9;
  for (const std::vector<Key>& keys : robot_paths(graph, robots)) {
    std::vector<std::size_t> known;
    for (std::size_t i = 0; i < keys.size(); ++i) {
      if (stamps.count(keys[i]) != 0) known.push_back(i);
    }
    const auto at = [&](std::size_t i) { return static_cast<double>(stamps.at(keys[i])); };
    std::size_t next = 0;  // the first entry of `known` after i
    std::vector<std::pair<Key, double>> made;
    for (std::size_t i = 0; i < keys.size(); ++i) {
      if (next < known.size() && known[next] == i) {
        ++next;
        continue;
      }
      problems.add("node without stamp", name + ": " + key_name(keys[i]));
      double stamp = static_cast<double>(i) * interval_ns;
      if (next > 0 && next < known.size()) {
        const std::size_t a = known[next - 1], b = known[next];
        stamp = at(a) + (at(b) - at(a)) * static_cast<double>(i - a) / static_cast<double>(b - a);
      } else if (next > 0) {
        stamp = at(known[next - 1]) + static_cast<double>(i - known[next - 1]) * interval_ns;
      } else if (!known.empty()) {
        stamp = at(known.front()) - static_cast<double>(known.front() - i) * interval_ns;
      }
      made.emplace_back(keys[i], stamp);
    }
    constexpr double kLargest = 4.6e18;  // as stamp_in_range()
    for (const auto& [key, stamp] : made) {
      stamps[key] = static_cast<std::int64_t>(std::llround(std::clamp(stamp, -kLargest, kLargest)));
    }
  }
  for (const auto& [key, stamp] : first_sightings(graph, robots, stamps)) stamps.emplace(key, stamp);
}

std::string name_of(const fs::path& path) {
  const fs::path whole = fs::absolute(path).lexically_normal();
  const fs::path last = whole.has_filename() ? whole : whole.parent_path();
  return (fs::is_directory(path) ? last.filename() : last.stem()).string();
}

std::string recording_name(const fs::path& path) {
  const std::string name = name_of(path);
  const bool names_format = name == "g2o_pcd" || name == "rosbag" || name == "bags" || name == "pose_graph";
  return names_format && fs::is_directory(path)
             ? name_of(fs::absolute(path / "").lexically_normal().parent_path() / "..")
             : name;
}

std::string provenance_of(MissionKind kind, const std::vector<std::string>& sources) {
  Json json = Json::object();
  json["read_from"] = {{"kind", enum_name(kind)}, {"sources", sources}};
  return json_text(json);
}

std::vector<fs::path> entries(const fs::path& folder) {
  std::vector<fs::path> out;
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    if (entry->path().filename().string().front() != '.') out.push_back(entry->path());
  }
  if (error) throw IoError(folder.string(), error.message());
  std::sort(out.begin(), out.end());  // the order of a folder is not defined
  return out;
}

void require_empty(const fs::path& folder) {
  std::error_code error;
  const fs::file_status status = fs::status(folder, error);
  if (status.type() == fs::file_type::not_found) return;
  if (status.type() != fs::file_type::none && !fs::is_directory(status)) {
    throw IoError(folder.string(), "exists and is not a folder");
  }
  const bool empty = status.type() != fs::file_type::none && fs::is_empty(folder, error);
  if (error) throw IoError(folder.string(), error.message());
  if (!empty) {
    throw IoError(folder.string(), "exists and is not empty: a mission is written to a folder of its own");
  }
}

bool exists(const fs::path& path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (status.type() == fs::file_type::not_found) return false;
  if (error) throw IoError(path.string(), error.message());
  return true;
}

bool begins_with(const fs::path& file, std::string_view bytes) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw IoError(file.string(), "cannot be opened");
  std::string start(bytes.size(), '\0');
  in.read(start.data(), static_cast<std::streamsize>(start.size()));
  if (in.bad()) throw IoError(file.string(), "cannot be read");
  return static_cast<std::size_t>(in.gcount()) == bytes.size() && start == bytes;
}

bool is_truth(const fs::path& path) {
  const std::string name = path.filename().string();
  return kTruthFolders.count(name) != 0 || kTruthFiles.count(name) != 0;
}

TruthFiles find_truth(const fs::path& folder) {
  TruthFiles truth;
  const fs::path parent = fs::absolute(folder / "").lexically_normal().parent_path().parent_path();
  for (const std::string& name : kTruthFiles) {
    if (fs::is_regular_file(folder / name)) {
      truth.g2o = folder / name;
      return truth;
    }
  }
  for (const fs::path& place : {folder, parent}) {
    for (const std::string& name : kTruthFolders) {
      const fs::path own = place / name;
      if (!fs::is_directory(own)) continue;
      std::vector<fs::path> graphs;
      for (const fs::path& file : entries(own)) {
        if (!fs::is_regular_file(file)) continue;
        if (file.extension() == ".g2o") graphs.push_back(file);
      }
      Problems unused;  // problems of the truth's folder do not concern the mission
      for (const bags::Parts& files : bags::bags_of_folder(own, unused))
        truth.bags.insert(truth.bags.end(), files.begin(), files.end());
      if (fs::is_regular_file(own / "result.g2o")) {
        truth.g2o = own / "result.g2o";
      } else if (graphs.size() == 1) {
        truth.g2o = graphs.front();
      } else if (graphs.size() > 1) {
        throw InputError(own.string() + ": " + std::to_string(graphs.size()) +
                         " g2o files: name the one to read result.g2o");
      }
      if (!truth.g2o.empty()) truth.bags.clear();
      if (!truth.g2o.empty() || !truth.bags.empty()) return truth;
    }
  }
  return truth;
}

std::map<Key, Eigen::Isometry3d> read_truth(const fs::path& g2o, Problems& problems) {
  const G2oFile file = read_g2o(g2o);
  problems.add(file.problems);
  std::map<Key, Eigen::Isometry3d> truth;
  for (const Node& node : file.graph.nodes()) truth.emplace(node.key, node.pose);
  return truth;
}

void set_scans(Mission& mission, const std::vector<Key>& keys, ScanStore::CloudSource source,
               const std::function<std::string(Key)>& where, const MissionOptions& options) {
  count_scans(mission, keys, where);
  mission.scans = std::make_shared<ScanStore>(keys, std::move(source), scan_bytes(options));
}

namespace {

/// Aligns the truth by least squares of the positions, or by the first pose if there are too few.
void align_truth(Mission& mission) {
  const auto count = static_cast<Eigen::Index>(mission.ground_truth.size());
  Eigen::Matrix3Xd truth(3, count), nodes(3, count);
  Eigen::Index i = 0;
  for (const auto& [key, pose] : mission.ground_truth) {
    truth.col(i) = pose.translation();
    nodes.col(i++) = mission.graph.node(key).pose.translation();
  }
  const auto& [key, first] = *mission.ground_truth.begin();
  Eigen::Isometry3d T = se3::normalized(mission.graph.node(key).pose * first.inverse());
  if (count >= 3) {
    const Eigen::Matrix4d alignment = Eigen::umeyama(truth, nodes, false);
    if (alignment.allFinite()) T = se3::normalized(Eigen::Isometry3d(alignment));
  }
  for (auto& entry : mission.ground_truth) entry.second = se3::normalized(T * entry.second);
}

}  // namespace

void align_truth_to_nodes(Mission& mission, const std::string& source) {
  if (mission.ground_truth.empty()) return;
  const auto& [key, first] = *mission.ground_truth.begin();
  constexpr double kNear_m = 0.5, kNear_rad = 0.1;
  const Eigen::Isometry3d off = mission.graph.node(key).pose.inverse() * first;
  if (off.translation().norm() < kNear_m && Eigen::AngleAxisd(off.linear()).angle() < kNear_rad) return;
  mission.truth_is_aligned = true;
  mission.problems.add("truth in another frame",
                       source + ": aligned to the nodes, so errors are those after alignment");
  align_truth(mission);
}

}  // namespace loopwise::parts
