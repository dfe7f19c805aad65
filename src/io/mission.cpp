// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/mission.hpp>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>

#include "bag.hpp"
#include "bag_files.hpp"
#include "file_kind.hpp"
#include "hdl_graph_slam.hpp"
#include "key_pairs.hpp"
#include "mission_parts.hpp"
#include "raw_sequence.hpp"
#include "rtabmap.hpp"
#include "saved_maps.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr const char* kWantedMission =
    "a mission (folder, g2o graph, bag of ROS 1 or 2, or zip archive of LAMP)";

bool has_file(const fs::path& folder, const char* name) {
  return fs::is_regular_file(folder / name);
}

Mission read_g2o_mission(const fs::path& path, const MissionOptions& options) {
  G2oFile file = read_g2o(path);
  Mission mission;
  mission.kind = MissionKind::kG2o;
  mission.name = path.stem().string();
  mission.path = path;
  mission.problems = std::move(file.problems);
  mission.robots = parts::robots_of(file.graph, options, Robots::from_keys(file.graph.keys()));
  std::vector<PriorFactor> priors = file.graph.priors();
  if (priors.empty()) {
    const std::vector<Key> firsts = parts::first_nodes(file.graph, mission.robots);
    priors.push_back(parts::default_prior(file.graph, firsts.front(), options));
    if (firsts.size() > 1) {
      mission.problems.add("no prior given",
                           path.string() + ": node " + std::to_string(firsts.front()) + " gets one");
    }
  }
  mission.problems.add("no stamps given", path.string());
  mission.graph =
      parts::assemble(file.graph, parts::regular_stamps(file.graph, mission.robots, options), priors,
                      mission.robots, options, mission.problems, file.without_information);
  parts::check_stamps(mission);
  return mission;
}

}  // namespace

namespace parts {

bool stamp_in_range(std::int64_t stamp_ns) {
  constexpr std::int64_t kLargest = 4'600'000'000'000'000'000;
  return stamp_ns >= -kLargest && stamp_ns <= kLargest;
}

Robots robots_of(const PoseGraph& graph, const MissionOptions& options, const Robots& otherwise) {
  Robots robots = otherwise;
  if (!options.robots.empty()) {
    std::vector<Robot> listed = parse_robots(options.robots).all();
    for (const Robot& robot : otherwise.all()) {
      if (robot.landmarks) listed.push_back(robot);
    }
    robots = Robots(std::move(listed));
  }
  for (const Node& node : graph.nodes()) static_cast<void>(robots.of(node.key));
  return robots;
}

PoseGraph with_stamps(const PoseGraph& graph, const Stamps& stamps, const std::vector<PriorFactor>& priors) {
  PoseGraph out;
  out.set_planar(graph.planar());
  for (Node node : graph.nodes()) {
    const auto stamp = stamps.find(node.key);
    node.stamp_ns = stamp == stamps.end() ? 0 : stamp->second;
    out.add_node(node);
  }
  for (const PriorFactor& prior : priors) out.add_prior(prior);
  for (const Edge& edge : graph.edges()) out.add_edge(edge);
  for (const RangeFactor& range : graph.ranges()) out.add_range(range);
  for (const GravityFactor& gravity : graph.gravities()) out.add_gravity(gravity);
  return out;
}

PoseGraph assemble(const PoseGraph& graph, const Stamps& stamps, const std::vector<PriorFactor>& priors,
                   const Robots& robots, const MissionOptions& options, Problems& problems,
                   const std::vector<std::size_t>& without_information) {
  PoseGraph out = with_stamps(graph, stamps, priors);
  problems.add(classify_edges(out, robots, options, without_information));
  return out;
}

OdometryList odometry_list(const PoseGraph& graph, const Robots& robots) {
  const auto is_sighting = [&](const Edge& edge) {
    return robots.is_landmark(edge.from) || robots.is_landmark(edge.to);
  };
  const auto is_odometry = [](const Edge& edge) { return edge.kind == EdgeKind::kOdometry; };
  PoseGraph read = graph;
  const auto others = [&] {
    std::size_t count = 0;
    for (std::size_t e = 0; e < graph.edges().size(); ++e) {
      const Edge& edge = graph.edges()[e];
      if (!is_sighting(edge) && is_odometry(edge) != is_odometry(read.edges()[e])) ++count;
    }
    return count;
  };
  static_cast<void>(classify_edges(read, robots));
  OdometryList list;
  if (others() == 0) return list;
  KeyPairs pairs;
  for (const Edge& edge : graph.edges()) {
    if (!is_sighting(edge) && is_odometry(edge)) pairs.insert(std::minmax(edge.from, edge.to));
  }
  if (pairs.empty()) {  // the graph was never classified
    list.lost = others();
    return list;
  }
  list.text = "# from,to of the edges that are odometry\n";
  for (const auto& [a, b] : pairs) list.text += std::to_string(a) + "," + std::to_string(b) + "\n";
  static_cast<void>(classify_edges(read, robots, pairs));
  list.lost = others();
  return list;
}

Stamps regular_stamps(const PoseGraph& graph, const Robots& robots, const MissionOptions& options) {
  std::vector<Key> keys = graph.keys();
  std::sort(keys.begin(), keys.end());
  std::vector<std::size_t> count(robots.size(), 0);
  Stamps stamps;
  for (const Key key : keys) {
    if (robots.is_landmark(key)) continue;
    const double time_s = options.node_interval_s * static_cast<double>(count[robots.of(key)]++);
    stamps[key] = static_cast<std::int64_t>(std::llround(std::min(time_s, 1e9) * 1e9));
  }
  for (const auto& [key, stamp] : first_sightings(graph, robots, stamps)) stamps.emplace(key, stamp);
  return stamps;
}

std::vector<Key> first_nodes(const PoseGraph& graph, const Robots& robots) {
  std::map<std::size_t, Key> first;
  for (const Node& node : graph.nodes()) {
    if (robots.is_landmark(node.key)) continue;
    const auto [entry, is_new] = first.emplace(robots.of(node.key), node.key);
    if (!is_new) entry->second = std::min(entry->second, node.key);
  }
  std::vector<Key> keys;
  keys.reserve(first.size());
  for (const auto& [robot, key] : first) keys.push_back(key);
  return keys;
}

Matrix6d information_of_sigmas(const double* sigmas) {
  Matrix6d information = Matrix6d::Zero();
  for (int i = 0; i < 6; ++i) information(i, i) = 1.0 / (sigmas[i] * sigmas[i]);
  return information;
}

Matrix6d closure_information() {
  constexpr double kSigmas[] = {0.1, 0.1, 0.1, 0.02, 0.02, 0.02};
  return information_of_sigmas(kSigmas);
}

PriorFactor default_prior(const PoseGraph& graph, Key key, const MissionOptions& options) {
  return {key, graph.node(key).pose, information_of_sigmas(options.prior_sigmas.data())};
}

std::string cloud_stem(const fs::path& file) {
  const fs::path stem = file.stem();
  return (file.extension() == ".bin" && stem.extension() == ".pcd" ? stem.stem() : stem).string();
}

std::map<Key, fs::path> find_scans(const fs::path& folder,
                                   const std::function<std::optional<Key>(const std::string&)>& key_of,
                                   Problems& problems) {
  std::map<Key, fs::path> scans;
  if (!parts::exists(folder)) return scans;
  std::set<fs::path> files;  // sorted: the order of a folder is not defined
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    if (entry->path().filename().string().front() == '.') continue;
    std::error_code unknown;
    if (entry->is_other(unknown)) {  // reading a pipe would block
      problems.add("foreign file in scans", entry->path().string());
    } else {
      files.insert(entry->path());
    }
  }
  if (error) throw IoError(folder.string(), error.message());
  for (const fs::path& file : files) {
    const auto key = is_cloud_file(file) ? key_of(cloud_stem(file)) : std::nullopt;
    if (!key) {
      problems.add("foreign file in scans", file.string());
    } else if (!scans.emplace(*key, file).second) {
      problems.add("repeated scan", file.string() + ", taken: " + scans.at(*key).filename().string());
    }
  }
  return scans;
}

void count_scans(Mission& mission, const std::vector<Key>& keys,
                 const std::function<std::string(Key)>& where) {
  const std::set<Key> present(keys.begin(), keys.end());
  if (keys.empty()) {
    mission.problems.add("node without scan", "no scans at all",
                         key_frames(mission.graph, mission.robots).size());
  } else {
    for (const Node& node : mission.graph.nodes()) {
      if (present.count(node.key) == 0 && !mission.robots.is_landmark(node.key))
        mission.problems.add("node without scan", "node " + key_name(node.key));
    }
  }
  for (const Key key : present) {
    if (!mission.graph.contains(key)) mission.problems.add("scan without node", where(key));
  }
}

std::size_t scan_bytes(const MissionOptions& options) {
  return static_cast<std::size_t>(std::min(options.scan_cache_mb, 1e9) * 1e6);
}

void set_scans(Mission& mission, std::map<Key, fs::path> files, const MissionOptions& options) {
  std::vector<Key> keys;
  keys.reserve(files.size());
  for (const auto& [key, file] : files) keys.push_back(key);
  count_scans(mission, keys, [&](Key key) { return files.at(key).string(); });
  mission.scans = std::make_shared<ScanStore>(std::move(files), scan_bytes(options), options.bin_layout);
}

namespace {

void drop_without_node(std::map<Key, Eigen::Isometry3d>& poses, const char* problem, Mission& mission) {
  for (auto entry = poses.begin(); entry != poses.end();) {
    if (mission.graph.contains(entry->first)) {
      ++entry;
    } else {
      mission.problems.add(problem, "key " + key_name(entry->first));
      entry = poses.erase(entry);
    }
  }
}

}  // namespace

void set_reference(Mission& mission, std::map<Key, Eigen::Isometry3d> reference) {
  drop_without_node(reference, "reference without node", mission);
  mission.reference = std::move(reference);
}

void set_ground_truth(Mission& mission, std::map<Key, Eigen::Isometry3d> truth) {
  drop_without_node(truth, "ground truth without node", mission);
  for (const Node& node : mission.graph.nodes()) {
    if (truth.count(node.key) == 0 && !mission.robots.is_landmark(node.key))
      mission.problems.add("node without ground truth", "node " + key_name(node.key));
  }
  mission.ground_truth = std::move(truth);
}

void check_stamps(Mission& mission) {
  std::map<Key, std::int64_t> stamps;
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.robots.is_landmark(node.key)) stamps.emplace(node.key, node.stamp_ns);
  }
  if (stamps.empty()) return;
  mission.start_ns = stamps.begin()->second;
  for (const auto& [key, stamp] : stamps) mission.start_ns = std::min(mission.start_ns, stamp);
  for (auto b = std::next(stamps.begin()), a = stamps.begin(); b != stamps.end(); ++a, ++b) {
    if (b->second <= a->second && mission.robots.find(a->first) == mission.robots.find(b->first)) {
      mission.problems.add("stamps not ascending",
                           "nodes " + key_name(a->first) + " and " + key_name(b->first));
    }
  }
}

}  // namespace parts

std::string odometry_list(const PoseGraph& graph, const Robots& robots) {
  return parts::odometry_list(graph, robots).text;
}

namespace {

/// `joins(a, b)`: whether an edge between these nodes may be odometry.
template <class Joins>
void fill_information(PoseGraph& graph, const std::vector<std::size_t>& edges, const MissionOptions& options,
                      Joins&& joins) {
  for (const std::size_t e : edges) {
    const Edge& edge = graph.edges()[e];
    graph.set_information(e, joins(edge.from, edge.to) ? odometry_information(edge.T_from_to, options)
                                                       : parts::closure_information());
  }
}

}  // namespace

Problems classify_edges(PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                        const std::vector<std::size_t>& without_information) {
  if (options.odometry.empty()) {
    fill_information(graph, without_information, options, Neighbours(graph, robots));
    return classify_edges(graph, robots);
  }
  const KeyPairs pairs = parts::parse_key_pairs(read_file(options.odometry), options.odometry);
  fill_information(graph, without_information, options, [&](Key a, Key b) {
    return pairs.count({a, b}) + pairs.count({b, a}) != 0;
  });
  try {
    return classify_edges(graph, robots, pairs);
  } catch (const InputError& error) {
    throw InputError(options.odometry + ": " + error.what());
  }
}

Matrix6d odometry_information(const Eigen::Isometry3d& T, const MissionOptions& options) {
  static constexpr double kLargest = 1e12;  // beyond, the information and thus the edge vanish
  const double length = T.translation().stableNorm();
  const auto sigma = [length](double least, double per_m) {
    return std::min(kLargest, std::max(least, per_m * length));
  };
  const double m = sigma(options.odometry_min_sigma_m, options.odometry_sigma_m_per_m);
  const double rad = sigma(options.odometry_min_sigma_rad, options.odometry_sigma_rad_per_m);
  const double sigmas[] = {m, m, m, rad, rad, rad};
  return parts::information_of_sigmas(sigmas);
}

namespace {

/// The folder of a mission. The folder of a data set stands for the most complete form of its data.
fs::path mission_in(const fs::path& path) {
  if (path.filename() == "mission.json" || path.filename() == "metadata.yaml")
    return path.has_parent_path() ? path.parent_path() : fs::path(".");
  if (!fs::is_directory(path) || has_file(path, "mission.json")) return path;
  // Bags contain more than files that were made from them: stamps, priors, first estimates.
  const bool has_g2o = fs::is_directory(path / "g2o_pcd");
  const bool has_bags = fs::is_directory(path / "rosbag") && bags::has_bags(path / "rosbag");
  if (has_bags && (bags::available() || bags::rosbag2_available() || !has_g2o)) return path / "rosbag";
  return has_g2o ? path / "g2o_pcd" : path;
}

/// Recognises the file by its beginning. Tests the ending first, because other files may be large or pipes.
bool is_open3d_file(const fs::path& path) {
  if (path.extension() != ".json" || !fs::is_regular_file(path)) return false;
  std::ifstream in(path, std::ios::binary);
  std::string beginning(kKindBytes, '\0');
  in.read(beginning.data(), static_cast<std::streamsize>(beginning.size()));
  beginning.resize(static_cast<std::size_t>(in.gcount()));
  return parts::looks_like_open3d(beginning);
}

bool is_sqlite_file(const fs::path& path) {
  return parts::begins_with(path, std::string_view("SQLite format 3\0", 16));
}

bool is_bag_file(const fs::path& path) {
  if (path.filename() == "metadata.yaml") return bags::is_rosbag2_folder(mission_in(path));
  // A file that is compressed with zstd may contain anything, so its name decides.
  const bool is_packed = bags::is_bag_name(path) && parts::begins_with(path, "\x28\xb5\x2f\xfd");
  return is_packed || parts::begins_with(path, "#ROSBAG") || parts::begins_with(path, "\x89MCAP0\r\n") ||
         is_sqlite_file(path);
}

void check_options(const MissionOptions& options) {
  validate(options);
  if (options.prior_sigmas.size() != 6) {
    throw OptionError("prior_sigmas has " + std::to_string(options.prior_sigmas.size()) +
                      " numbers, must have 6: x, y, z, roll, pitch, yaw");
  }
}

}  // namespace

MissionKind mission_kind(const fs::path& path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status))
    throw IoError(path.string(), error ? error.message() : "No such file or directory");
  if (!fs::is_directory(status)) {
    if (path.filename() == "mission.json") return MissionKind::kMission;
    if (fs::is_regular_file(status) && is_sqlite_file(path) && parts::is_rtabmap_database(path))
      return MissionKind::kRtabmap;
    if (fs::is_regular_file(status) && is_bag_file(path)) return MissionKind::kBags;
    if (fs::is_regular_file(status) && parts::begins_with(path, "PK\x03\x04")) return MissionKind::kLampZip;
    if (is_open3d_file(path)) return MissionKind::kOpen3d;
    refuse_foreign_file(path, {FileKind::kG2o}, kWantedMission);
    return MissionKind::kG2o;
  }
  const fs::path folder = mission_in(path);
  if (has_file(folder, "mission.json")) return MissionKind::kMission;
  if (has_file(folder, parts::kUnfinished)) {
    throw InputError(
        folder.string() +
        ": an incomplete mission: its conversion is still running or was interrupted, expected mission.json");
  }
  if (has_file(folder, "optimized_poses.txt") || has_file(folder, "odom_poses.txt"))
    return MissionKind::kSession;
  if (has_file(folder, "keys.csv") && has_file(folder, "pose_graph.bag")) return MissionKind::kLampZip;
  if (has_file(folder, "summary.json") && has_file(folder, "closures.csv") && has_file(folder, "graph.g2o"))
    return MissionKind::kRun;
  if (const auto saved = parts::saved_map_kind(folder)) return *saved;
  if (is_mrg_slam(folder)) return MissionKind::kG2oPcd;
  const fs::path graph = parts::g2o_of_folder(folder);
  // The graph of a session is empty until its program ends.
  const bool is_begun = graph.filename() == "singlesession_posegraph.g2o" && fs::is_empty(graph);
  if (!graph.empty() && !is_begun) return MissionKind::kG2oPcd;
  if (bags::has_bags(folder)) return MissionKind::kBags;
  if (parts::is_kitti_sequence(folder)) return MissionKind::kKitti;
  if (!parts::stamped_clouds_of(folder).empty()) return MissionKind::kStampedClouds;
  // Tested last, because other programs may keep a database beside their own files.
  if (!parts::rtabmap_databases(folder).empty()) return MissionKind::kRtabmap;
  const std::string what = describe_foreign_folder(folder);
  if (!what.empty()) throw InputError(folder.string() + ": is not a mission: it " + what);
  throw InputError(
      path.string() +
      ": is not a mission: expected mission.json or result.g2o (which are written last: without them "
      "a mission is not "
      "complete), optimized_poses.txt or odom_poses.txt of a session, *.bag, *.db3, *.mcap, rosbag/ or "
      "g2o_pcd/, or the path of a "
      "g2o file, a bag or a zip archive");
}

namespace {

/// Names come from files, folders and topics in any encoding. Summaries, tables and pictures need UTF-8.
Mission with_legible_names(Mission mission) {
  const auto to_utf8 = [&](std::string& name) {
    if (text::is_utf8(name)) return false;
    name = text::legible(name);
    mission.problems.add("name is not UTF-8", name);
    return true;
  };
  to_utf8(mission.name);
  std::vector<Robot> robots = mission.robots.all();
  std::set<std::string> names;
  bool changed = false;
  for (Robot& robot : robots) {
    changed = to_utf8(robot.name) || changed;
    while (!names.insert(robot.name).second) robot.name += '_';
  }
  if (changed) mission.robots = Robots(std::move(robots));
  for (BeaconDrop& drop : mission.beacons) to_utf8(drop.beacon);
  for (RadioReading& reading : mission.radio) {
    to_utf8(reading.beacon);
    to_utf8(reading.receiver);
  }
  return mission;
}

Mission finished(Mission mission, const MissionOptions& options) {
  const bool of_sweeps = mission.kind == MissionKind::kKitti || mission.kind == MissionKind::kStampedClouds;
  if (!options.poses.empty() && !of_sweeps)
    mission.problems.add("file of poses not used",
                         options.poses + ": " + mission.path.string() + " has its own");
  if (options.strict) require_unaltered(mission.problems);
  return with_legible_names(std::move(mission));
}

Mission read_as_named(const fs::path& path, const MissionOptions& options, const ProgressCallback& progress,
                      const StopToken& stop) {
  const parts::Work work{progress, stop};
  const MissionKind kind = mission_kind(path);
  const fs::path place = mission_in(path);
  switch (kind) {
    case MissionKind::kMission:
      return parts::read_mission_folder(place, options);
    case MissionKind::kSession:
      return parts::read_session(place, options);
    case MissionKind::kRun: {
      Mission mission = parts::read_g2o_pcd(place, options, work);
      mission.kind = kind;
      mission.provenance_json = parts::provenance_of(kind, {"graph.g2o"});
      return mission;
    }
    case MissionKind::kG2oPcd: {
      Mission mission = parts::read_g2o_pcd(place, options, work);
      if (place != path && fs::is_directory(path / "rosbag") && bags::has_bags(path / "rosbag")) {
        mission.problems.add("bags not read", path.string() + ": " + bags::kUnavailable);
      }
      return mission;
    }
    case MissionKind::kBags:
      return parts::read_bags({place}, options, work);
    case MissionKind::kLampZip:
      return parts::read_lamp_save(place, options, work);
    case MissionKind::kKitti:
      return parts::read_kitti_sequence(place, options);
    case MissionKind::kStampedClouds:
      return parts::read_stamped_clouds(place, options);
    case MissionKind::kGlim:
    case MissionKind::kFastLioSamQn:
    case MissionKind::kVoxelSlam:
    case MissionKind::kHba:
    case MissionKind::kKissSlam:
    case MissionKind::kOpen3d:
      return parts::read_saved_map(kind, place, options);
    case MissionKind::kRtabmap:
      return parts::read_rtabmap(place, options, work);
    case MissionKind::kG2o:
    case MissionKind::kJoined:
      break;
  }
  return read_g2o_mission(path, options);
}

}  // namespace

Mission read_mission(const fs::path& path, const MissionOptions& options, const ProgressCallback& progress,
                     const StopToken& stop) {
  check_options(options);
  return finished(read_as_named(path, options, progress, stop), options);
}

Mission read_missions(const std::vector<fs::path>& paths, const MissionOptions& options,
                      const ProgressCallback& progress, const StopToken& stop) {
  check_options(options);
  if (paths.empty()) throw InputError("no mission given");
  if (options.frames == "auto" || options.frames == "common") {
    throw OptionError("frames = \"" + options.frames +
                      "\": only convert, replay and align accept this word; here a file is expected (./" +
                      options.frames + " if it has this name)");
  }
  if (paths.size() == 1 && (!options.frames.empty() || options.start_together)) {
    throw OptionError("frames and start_together need several missions, one is given");
  }
  if (paths.size() == 1) return read_mission(paths.front(), options, progress, stop);
  if (!options.poses.empty()) {
    throw OptionError("poses: one file is given for " + std::to_string(paths.size()) +
                      " sources: convert each source with its own file first");
  }
  std::vector<fs::path> bag_paths;
  for (const fs::path& path : paths) {
    if (mission_kind(path) == MissionKind::kBags) bag_paths.push_back(mission_in(path));
  }
  const bool one_recording = bag_paths.size() == paths.size();
  if (one_recording && (!options.frames.empty() || options.start_together)) {
    throw OptionError(
        "frames and start_together cannot be used with bags, which are one recording with one frame and one "
        "clock");
  }
  if (one_recording) return finished(parts::read_bags(bag_paths, options, {progress, stop}), options);
  MissionOptions of_one = options;
  of_one.robots.clear();  // they are robots of the joined mission, not of its parts
  of_one.odometry.clear();
  of_one.scan_cache_mb /= static_cast<double>(paths.size());
  std::vector<Mission> missions;
  missions.reserve(paths.size());
  for (const fs::path& path : paths) missions.push_back(read_mission(path, of_one, progress, stop));
  return finished(parts::join_missions(missions, options), options);
}

}  // namespace loopwise
