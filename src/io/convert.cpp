// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/convert.hpp>

#include <unistd.h>

#include <algorithm>
#include <map>
#include <mutex>
#include <set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/trajectory.hpp>

#include "cloud_points.hpp"
#include "convert_parts.hpp"
#include "mission_parts.hpp"
#include "renamed_graph.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr const char* kResultGraph = "result.g2o";
constexpr const char* kClouds = "pcd";

/// Creates a folder of this process beside the target folder.
fs::path new_folder_beside(const fs::path& folder) {
  parts::make_folder(folder.parent_path());
  for (int attempt = 0;; ++attempt) {
    fs::path made =
        folder.parent_path() / ("." + folder.filename().string() + "." + std::to_string(::getpid()) + "-" +
                                std::to_string(attempt) + ".tmp");
    std::error_code error;
    if (fs::create_directory(made, error)) return made;
    if (error && error != std::errc::file_exists) throw IoError(made.string(), error.message());
    if (attempt == 1000) throw IoError(made.string(), "already exists");
  }
}

/// Removes written files unless keep() was called.
class Target {
 public:
  explicit Target(const fs::path& folder) : Target(folder, fs::exists(folder)) {}
  Target(fs::path folder, bool existed) : folder_(std::move(folder)), existed_(existed) {}
  ~Target() {
    if (done_) return;
    try {
      remove();
    } catch (const std::exception&) {
      // If memory is missing even here, the remaining files keep the mark of an unfinished mission.
    }
  }
  Target(const Target&) = delete;
  Target& operator=(const Target&) = delete;
  void keep() { done_ = true; }

 private:
  void remove() const {
    std::error_code ignored;
    if (!existed_) {
      fs::remove_all(folder_, ignored);
      return;
    }
    for (fs::directory_iterator entry(folder_, ignored), end; !ignored && entry != end;
         entry.increment(ignored)) {
      std::error_code failed;
      fs::remove_all(entry->path(), failed);
    }
  }

  fs::path folder_;
  bool existed_;
  bool done_ = false;
};

void count_lost_kinds(const parts::OdometryList& odometry, const std::string& name, Problems& left_out) {
  left_out.add("kind of an edge left out", name + ": of several between the same nodes", odometry.lost);
}

ConvertResult write_folder(const Mission& mission, const fs::path& folder, const ConvertOptions& options) {
  ConvertResult result;
  const MissionWriter writer(folder, options.encoding);
  result.scans = parts::write_scans(mission, mission.scans->keys(), options,
                                    [&](Key key, const PointCloud& cloud) { writer.add_scan(key, cloud); });
  writer.finish(mission);
  count_lost_kinds(parts::odometry_list(mission.graph, mission.robots), mission.name, result.left_out);
  return result;
}

/// The mission's keys for files without a list of robots. Robots differ by their characters, and landmarks
/// have characters that read_mission() takes for landmarks.
class FullKeys {
 public:
  FullKeys(const Mission& mission, Problems& left_out) : robots_(mission.robots) {
    const std::vector<Key> keys = mission.graph.keys();
    std::map<std::size_t, char> character_of;
    for (const Key key : keys) {
      const std::size_t robot = robots_.of(key);
      const char character = key_character(key);
      const auto [known, is_new] = character_of.emplace(robot, character);
      renamed_ = renamed_ || (!is_new && known->second != character) ||
                 (robots_[robot].landmarks && !parts::is_landmark_character(character));
    }
    std::set<char> used;
    for (const auto& [robot, character] : character_of) {
      renamed_ = renamed_ || !used.insert(character).second;
    }
    if (renamed_) assign_letters();

    std::vector<Key> written;
    std::set<char> landmarks;
    std::map<std::size_t, Key> first;
    for (const Key key : keys) {
      written.push_back(of(key));
      first.emplace(robots_.of(key), written.back());
      if (robots_.is_landmark(key)) landmarks.insert(key_character(written.back()));
    }
    read_ = parts::with_landmarks(Robots::from_keys(written), landmarks);
    for (const auto& [robot, key] : first) {
      const std::string& name = read_[read_.of(key)].name;
      if (robots_[robot].name != name) {
        left_out.add("robot name left out", robots_[robot].name + " becomes " + name);
      }
    }
    if (renamed_) {
      left_out.add("key renamed", std::to_string(keys.front()) + " becomes " + key_name(written.front()),
                   keys.size());
    }
  }

  [[nodiscard]] Key of(Key key) const {
    if (!renamed_) return key;
    const std::size_t robot = robots_.of(key);
    return make_key(letters_[robot], key - robots_[robot].first);
  }

  /// The robots as a reader of the files understands the keys.
  [[nodiscard]] const Robots& robots() const { return read_; }

 private:
  void assign_letters() {
    const std::string small = "abcdefghijklmnopqrstvwxyz";  // without 'u', which radio anchors have
    const std::string capital = "ABCDEFGHIJKLMNOPQRSTUVWXYZ";
    std::size_t robots = 0, landmarks = 0;
    for (const Robot& robot : robots_.all()) {
      const std::string& letters = robot.landmarks ? capital : small;
      std::size_t& next = robot.landmarks ? landmarks : robots;
      if (next == letters.size()) {
        throw InputError(std::to_string(robots_.size()) + " robots, at most " + std::to_string(next) +
                         " can be distinguished by a letter");
      }
      letters_ += letters[next++];
    }
  }

  Robots robots_;
  Robots read_;
  bool renamed_ = false;
  std::string letters_;  // by robot
};

PoseGraph renamed_truth(const Mission& mission, const FullKeys& keys) {
  PoseGraph truth;
  // The truth of a 2D graph may be a survey in 3D.
  truth.set_planar(mission.graph.planar() &&
                   std::all_of(mission.ground_truth.begin(), mission.ground_truth.end(),
                               [](const auto& known) { return planar::is_pose(known.second); }));
  for (const auto& [key, pose] : mission.ground_truth) {
    Node node;
    node.key = keys.of(key);
    node.pose = pose;
    truth.add_node(node);
  }
  return truth;
}

/// Writes the clouds. \returns the keys of those that were written
std::set<Key> write_clouds(const Mission& mission, const FullKeys& keys, const fs::path& folder,
                           const ConvertOptions& options, ConvertResult& result) {
  parts::make_folder(folder / kClouds);
  std::vector<Key> with_node;
  for (const Key key : mission.scans->keys()) {
    if (mission.graph.contains(key)) {
      with_node.push_back(key);
    } else {
      result.left_out.add("scan without node left out", key_name(key));
    }
  }
  std::mutex mutex;
  std::set<Key> written;
  result.scans = parts::write_scans(mission, with_node, options, [&](Key key, const PointCloud& cloud) {
    write_file(folder / kClouds / (std::to_string(keys.of(key)) + ".pcd"),
               points::pcd_text(cloud, options.encoding), Flush::kLater);
    const std::lock_guard<std::mutex> lock(mutex);
    written.insert(key);
  });
  return written;
}

ConvertResult write_g2o_pcd(const Mission& mission, const fs::path& folder, const ConvertOptions& options) {
  ConvertResult result;
  const FullKeys keys(mission, result.left_out);
  parts::count_description(mission, result.left_out);
  result.left_out.add("reference pose left out", mission.name, mission.reference.size());
  std::int64_t first_ns = mission.start_ns;
  for (const Node& node : mission.graph.nodes()) first_ns = std::max(first_ns, node.stamp_ns);
  for (const Node& node : mission.graph.nodes()) first_ns = std::min(first_ns, node.stamp_ns);
  if (mission.start_ns != first_ns) {
    result.left_out.add("clock's start left out", std::to_string(mission.start_ns) + " ns");
  }

  const std::set<Key> written = write_clouds(mission, keys, folder, options, result);
  std::string table;
  for (const Node& node : mission.graph.nodes()) {
    const std::string key = std::to_string(keys.of(node.key));
    table += key + "," + (written.count(node.key) != 0 ? kClouds + ("/" + key + ".pcd") : std::string()) +
             "," + std::to_string(node.stamp_ns) + "\n";
  }
  write_file(folder / "keys.csv", table);
  if (const PoseGraph truth = renamed_truth(mission, keys); !truth.empty()) {
    parts::make_folder(folder / "ground_truth");
    write_g2o(folder / "ground_truth" / kResultGraph, truth);
  }
  const PoseGraph graph = parts::renamed(mission.graph, [&](Key key) { return keys.of(key); });
  if (!graph.ranges().empty()) write_file(folder / parts::kRanges, parts::ranges_text(graph));
  if (!graph.gravities().empty()) write_file(folder / parts::kGravity, parts::gravity_text(graph));
  const parts::OdometryList odometry = parts::odometry_list(graph, keys.robots());
  if (!odometry.text.empty()) write_file(folder / parts::kOdometry, odometry.text);
  count_lost_kinds(odometry, mission.name, result.left_out);
  flush_file_system(folder);  // clouds first, because the graph marks the mission as complete
  write_g2o(folder / kResultGraph, graph);
  return result;
}

ConvertResult write_trajectories(const Mission& mission, const fs::path& folder, MissionFormat format) {
  ConvertResult result;
  parts::count_description(mission, result.left_out);
  const PoseGraph& graph = mission.graph;
  const auto leave_out = [&](const char* kind, std::size_t count) {
    result.left_out.add(kind, mission.name, count);
  };
  leave_out("edge left out", graph.edges().size());
  leave_out("prior left out", graph.priors().size());
  leave_out("range left out", graph.ranges().size());
  leave_out("gravity left out", graph.gravities().size());
  leave_out("scan left out", mission.scans->size());
  const std::size_t frames = parts::key_frames(graph, mission.robots).size();
  leave_out("landmark left out", graph.nodes().size() - frames);
  leave_out("key left out", frames);
  if (format == MissionFormat::kKitti) leave_out("stamp left out", frames);

  // Written beside the target and renamed, so that either all files exist or no file.
  const fs::path whole = fs::absolute(folder / "").lexically_normal().parent_path();
  const fs::path made = new_folder_beside(whole);
  Target unfinished(made, false);
  const std::string extension = "." + enum_name(format);
  std::set<std::string> names;
  for (std::size_t robot = 0; robot < mission.robots.size(); ++robot) {
    if (mission.robots[robot].landmarks) continue;
    std::map<Key, const Node*> own;
    for (const Node& node : graph.nodes()) {
      if (mission.robots.of(node.key) == robot) own.emplace(node.key, &node);
    }
    if (own.empty()) continue;
    const std::string plain = plain_file_name(mission.robots[robot].name);
    std::string name = plain;
    const auto is_used = [&](const std::string& file) { return names.count(file) > 0; };
    for (int n = 2; is_used(name) || is_used(name + "_truth") || is_used(name + "_reference"); ++n)
      name = plain + "_" + std::to_string(n);
    names.insert({name, name + "_truth", name + "_reference"});
    std::vector<StampedPose> poses;
    for (const auto& [key, node] : own) poses.push_back({node->stamp_ns, node->pose});
    const auto write = [&](const fs::path& file, const std::vector<StampedPose>& stamped) {
      if (format == MissionFormat::kTum) {
        write_tum(file, stamped);
        return;
      }
      std::vector<Eigen::Isometry3d> bare;
      bare.reserve(stamped.size());
      for (const StampedPose& pose : stamped) bare.push_back(pose.pose);
      write_kitti(file, bare);
    };
    write(made / (name + extension), poses);
    const auto write_known = [&](const std::map<Key, Eigen::Isometry3d>& known, const char* suffix,
                                 const char* incomplete) {
      std::vector<StampedPose> stamped;
      for (const auto& [key, node] : own) {
        if (const auto at = known.find(key); at != known.end())
          stamped.push_back({node->stamp_ns, at->second});
      }
      // KITTI poses have only their row as a name. With gaps, rows would belong to other nodes.
      if (format == MissionFormat::kKitti && !stamped.empty() && stamped.size() != poses.size()) {
        leave_out(incomplete, stamped.size());
      } else if (!stamped.empty()) {
        write(made / (name + suffix + extension), stamped);
      }
    };
    write_known(mission.ground_truth, "_truth", "incomplete ground truth left out");
    write_known(mission.reference, "_reference", "incomplete reference left out");
  }
  std::error_code error;
  fs::rename(made, whole, error);
  if (error) throw IoError(folder.string(), error.message());
  unfinished.keep();
  flush_file(whole.parent_path());
  return result;
}

}  // namespace

namespace parts {

void make_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw IoError(folder.string(), error.message());
}

void count_description(const Mission& mission, Problems& left_out) {
  if (mission.frame != "map") left_out.add("name of the frame left out", mission.frame);
  if (mission.provenance_json != "{}")
    left_out.add("provenance left out", mission.provenance_json.substr(0, 80));
  for (const CommunicationGap& gap : mission.gaps) {
    left_out.add("communication gap left out", mission.robots[gap.robot].name);
  }
  left_out.add("radio reading left out",
               mission.radio.empty() ? "" : "node " + key_name(mission.radio[0].key), mission.radio.size());
  left_out.add("beacon left out", mission.beacons.empty() ? "" : mission.beacons[0].beacon,
               mission.beacons.size());
}

}  // namespace parts

ConvertResult convert_mission(const Mission& mission, const fs::path& folder, MissionFormat format,
                              const ConvertOptions& options) {
  for (const Node& node : mission.graph.nodes()) static_cast<void>(mission.robots.of(node.key));
  parts::require_empty(folder);
  if (format == MissionFormat::kTum || format == MissionFormat::kKitti) {
    return write_trajectories(mission, folder, format);
  }
  Target target(folder);
  ConvertResult result;
  switch (format) {
    case MissionFormat::kMission:
      result = write_folder(mission, folder, options);
      break;
    case MissionFormat::kHdlGraphSlam:
      result = parts::write_hdl_graph_slam(mission, folder, options);
      break;
    case MissionFormat::kHba:
      result = parts::write_hba(mission, folder, options);
      break;
    default:
      result = write_g2o_pcd(mission, folder, options);
  }
  target.keep();
  return result;
}

}  // namespace loopwise
