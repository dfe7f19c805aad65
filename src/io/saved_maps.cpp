// SPDX-License-Identifier: BSD-3-Clause
#include "saved_maps.hpp"

#include <algorithm>
#include <cctype>
#include <fstream>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/trajectory.hpp>

#include "rtabmap.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

bool holds_file(const fs::path& folder, const char* name) {
  return fs::is_regular_file(folder / name);
}

std::string first_bytes(const fs::path& file) {
  constexpr std::size_t kEnough = 4096;
  std::ifstream in(file, std::ios::binary);
  if (!in) throw IoError(file.string(), "cannot be opened");
  std::string text(kEnough, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  return text;
}

/// The file of HBA is named JSON, but contains seven numbers per line.
bool is_hba(const fs::path& folder) {
  if (!holds_file(folder, "pose.json") || !fs::is_directory(folder / "pcd")) return false;
  const std::string text = first_bytes(folder / "pose.json");
  const std::size_t first = text.find_first_not_of(" \t\r\n");
  return first != std::string::npos &&
         (std::isdigit(static_cast<unsigned char>(text[first])) != 0 || text[first] == '-');
}

bool is_voxel_slam(const fs::path& folder) {
  if (holds_file(folder, "alidarState.txt")) return true;
  if (!holds_file(folder, "edge.txt")) return false;
  const std::vector<fs::path> all = entries(folder);
  return std::any_of(all.begin(), all.end(), [](const fs::path& entry) {
    return fs::is_directory(entry) && holds_file(entry, "alidarState.txt");
  });
}

bool has_open3d(const fs::path& folder) {
  const std::vector<fs::path> all = entries(folder);
  return std::any_of(all.begin(), all.end(), [](const fs::path& entry) {
    return entry.extension() == ".json" && fs::is_regular_file(entry) &&
           looks_like_open3d(first_bytes(entry));
  });
}

/// The number in a name: 12 for "000012".
std::optional<Key> number_of(const std::string& stem) {
  Key number = 0;
  const bool digits =
      !stem.empty() && std::all_of(stem.begin(), stem.end(), [](unsigned char c) { return std::isdigit(c); });
  if (!digits || text::parse_id(stem, number) != nullptr) return std::nullopt;
  return number;
}

/// Numbers of the frames: 0, 1, ….
std::vector<Key> rows(std::size_t count) {
  std::vector<Key> numbers;
  for (std::size_t i = 0; i < count; ++i) numbers.push_back(i);
  return numbers;
}

// FAST-LIO-SAM and FAST-LIO-SAM-QN

Mission read_fast_lio_sam(const fs::path& folder, const MissionOptions& options) {
  Problems problems;
  SavedFrames frames;
  const bool has_stamps = holds_file(folder, "poses_tum.txt");
  frames.source = folder / (has_stamps ? "poses_tum.txt" : "poses_kitti.txt");
  Trajectory poses =
      read_trajectory(frames.source, has_stamps ? TrajectoryFormat::kTum : TrajectoryFormat::kKitti);
  if (poses.problems.count("pose with a stamp before the preceding one, sorted") > 0) {
    throw InputError(frames.source.string() +
                     ": its stamps are not ascending, so its rows do not match those of scans/: remove "
                     "poses_tum.txt to read poses_kitti.txt, without stamps");
  }
  problems.add(poses.problems);
  frames.poses = std::move(poses.poses);
  frames.stamps_ns = std::move(poses.stamps_ns);
  frames.numbers = rows(frames.poses.size());
  frames.clouds = numbered_clouds(folder / "scans", problems);
  return mission_of_frames(frames, MissionKind::kFastLioSamQn, folder, options, std::move(problems));
}

// HBA

Mission read_hba(const fs::path& folder, const MissionOptions& options) {
  Problems problems;
  SavedFrames frames;
  frames.source = folder / "pose.json";
  const std::string name = frames.source.string(), contents = read_file(frames.source);
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    std::string_view look = line;
    if (text::next_word(look).empty()) continue;
    const text::Place place{name, lines.number()};
    double v[7];
    const std::size_t found = text::read_numbers(line, v, 7, place);
    if (found != 7) {
      place.fail("a pose of HBA needs 7 values (x y z qw qx qy qz), found " + std::to_string(found));
    }
    const double ordered[] = {v[0], v[1], v[2], v[4], v[5], v[6], v[3]};  // the scalar is first
    const text::Pose pose = text::pose_of(ordered, place);
    if (!pose.was_unit) problems.add_altered("non-unit quaternion", place.str());
    frames.poses.push_back(pose.pose);
  }
  if (frames.poses.empty()) throw InputError(name + ": has no poses");
  frames.numbers = rows(frames.poses.size());
  frames.clouds = numbered_clouds(folder / "pcd", problems);
  return mission_of_frames(frames, MissionKind::kHba, folder, options, std::move(problems));
}

/// Steps between frames, computed from their poses where the program did not store them.
std::vector<Eigen::Isometry3d> complete_steps(const SavedFrames& frames, Problems& problems) {
  std::vector<Eigen::Isometry3d> steps;
  for (std::size_t i = 0; i + 1 < frames.poses.size(); ++i) {
    if (i < frames.steps.size() && frames.steps[i]) {
      steps.push_back(se3::normalized(*frames.steps[i]));
      continue;
    }
    steps.push_back(se3::normalized(frames.poses[i].inverse() * frames.poses[i + 1]));
    problems.add("odometry taken from the optimised poses",
                 frames.source.string() + ": frame " + std::to_string(frames.numbers[i]) +
                     ": it has no drift; --odometry-noise adds some");
  }
  return steps;
}

}  // namespace

std::map<Key, fs::path> numbered_clouds(const fs::path& folder, Problems& problems) {
  return find_scans(folder, number_of, problems);
}

Mission mission_of_frames(const SavedFrames& frames, MissionKind kind, const fs::path& folder,
                          const MissionOptions& options, Problems problems) {
  if (frames.poses.empty()) throw InputError(frames.source.string() + ": has no poses");
  Mission mission;
  mission.kind = kind;
  mission.path = folder;
  mission.name = name_of(folder);
  mission.problems = std::move(problems);
  const std::vector<Eigen::Isometry3d> steps = complete_steps(frames, mission.problems);
  PoseGraph graph;
  Stamps stamps;
  std::map<Key, Eigen::Isometry3d> reference;
  try {
    Node node;
    for (std::size_t i = 0; i < frames.poses.size(); ++i) {
      node.key = frames.numbers[i];
      node.pose = i == 0 ? frames.poses[0] : se3::normalized(node.pose * steps[i - 1]);
      graph.add_node(node);
      reference.emplace(node.key, frames.poses[i]);
      if (i < frames.stamps_ns.size()) stamps.emplace(node.key, frames.stamps_ns[i]);
      if (i > 0) {
        graph.add_edge(
            {frames.numbers[i - 1], node.key, steps[i - 1], odometry_information(steps[i - 1], options)});
      }
    }
  } catch (const InputError& error) {
    throw InputError(frames.source.string() + ": " + error.what());
  }
  mission.robots = robots_of(graph, options, Robots({{"0", frames.numbers.front(), frames.numbers.back()}}));
  if (stamps.empty()) {
    mission.problems.add("no stamps given", frames.source.string());
    stamps = regular_stamps(graph, mission.robots, options);
  }
  std::vector<PriorFactor> priors;
  complete_priors(graph, mission.robots, options, frames.source.string(), priors, mission.problems);
  mission.graph = assemble(graph, stamps, priors, mission.robots, options, mission.problems);
  check_stamps(mission);
  set_reference(mission, std::move(reference));
  MissionOptions of_scans = options;
  if (frames.layout != BinLayout::kAuto) of_scans.bin_layout = frames.layout;
  set_scans(mission, frames.clouds, of_scans);
  mission.provenance_json = provenance_of(kind, {folder.filename().string()});
  return mission;
}

std::vector<fs::path> rtabmap_databases(const fs::path& folder) {
  std::vector<fs::path> databases;
  for (const fs::path& file : entries(folder)) {
    if (file.extension() == ".db" && fs::is_regular_file(file) &&
        begins_with(file, std::string_view("SQLite format 3\0", 16)) && is_rtabmap_database(file))
      databases.push_back(file);
  }
  return databases;
}

std::optional<MissionKind> saved_map_kind(const fs::path& folder) {
  if (holds_file(folder, "result.g2o")) return std::nullopt;  // a g2o_pcd folder
  if (holds_file(folder, "graph.txt") && begins_with(folder / "graph.txt", "num_submaps:"))
    return MissionKind::kGlim;
  if (fs::is_directory(folder / "scans") &&
      (holds_file(folder, "poses_tum.txt") || holds_file(folder, "poses_kitti.txt")))
    return MissionKind::kFastLioSamQn;
  if (is_hba(folder)) return MissionKind::kHba;
  if (is_voxel_slam(folder)) return MissionKind::kVoxelSlam;
  if (holds_file(folder, "local_map_graph.g2o") || holds_file(folder / "local_maps", "local_map_graph.g2o"))
    return MissionKind::kKissSlam;
  if (has_open3d(folder)) return MissionKind::kOpen3d;
  return std::nullopt;
}

Mission read_saved_map(MissionKind kind, const fs::path& path, const MissionOptions& options) {
  switch (kind) {
    case MissionKind::kGlim:
      return read_glim(path, options);
    case MissionKind::kVoxelSlam:
      return read_voxel_slam(path, options);
    case MissionKind::kKissSlam:
      return read_kiss_slam(path, options);
    case MissionKind::kOpen3d:
      return read_open3d(path, options);
    case MissionKind::kHba:
      return read_hba(path, options);
    default:
      return read_fast_lio_sam(path, options);
  }
}

}  // namespace loopwise::parts
