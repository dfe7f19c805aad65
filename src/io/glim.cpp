// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "saved_maps.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

/// A 4×4 matrix on the next four lines.
Eigen::Isometry3d read_matrix(text::Lines& lines, const std::string& name, const std::string& what,
                              Problems& problems) {
  double values[16];
  const text::Place place{name, lines.number()};
  for (int row = 0; row < 4; ++row) {
    std::string_view line;
    if (!lines.next(line))
      place.fail(what + " needs 4 rows of 4 numbers, the file ends after " + std::to_string(row));
    const text::Place at{name, lines.number()};
    const std::size_t found = text::read_numbers(line, values + 4 * row, 4, at);
    if (found != 4) at.fail(what + " needs 4 rows of 4 numbers, found " + std::to_string(found));
  }
  const text::Rigid rigid = text::rigid_of(values, place);
  if (!rigid.was_rotation) problems.add_altered("rotation not orthonormal", place.str());
  return rigid.pose;
}

/// Pose of a frame's IMU according to odometry.
Eigen::Isometry3d T_odom_imu(const GlimSubmap& submap, std::size_t frame) {
  return submap.T_odom_lidar[frame] * submap.T_lidar_imu;
}

/// Motion from the origin of one submap to that of the next. Within the submaps it follows the program's
/// alignment of frames, and between them odometry.
std::optional<Eigen::Isometry3d> step_between_submaps(const GlimSubmap& a, const GlimSubmap& b) {
  if (a.T_odom_lidar.empty() || b.T_odom_lidar.empty()) return std::nullopt;
  const Eigen::Isometry3d between = T_odom_imu(a, a.T_odom_lidar.size() - 1).inverse() * T_odom_imu(b, 0);
  return a.T_origin_last * between * b.T_origin_first.inverse();
}

std::size_t count_of(std::string_view line, const text::Place& place) {
  std::int64_t count = 0;
  if (!text::parse_int64(text::next_word(line), count) || count < 0 || count > 10'000'000)
    place.fail("expected a whole number from 0 to 10000000");
  return static_cast<std::size_t>(count);
}

struct Graph {
  std::size_t submaps = 0;
  std::size_t factors = 0;
};

Graph read_graph_file(const fs::path& file) {
  Graph graph;
  const std::string name = file.string(), contents = read_file(file);
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const std::string_view word = text::next_word(line);
    const text::Place place{name, lines.number()};
    if (word == "num_submaps:") graph.submaps = count_of(line, place);
    if (word == "num_matching_cost_factors:") graph.factors = count_of(line, place);
  }
  if (graph.submaps == 0) throw InputError(name + ": num_submaps is missing or 0");
  return graph;
}

fs::path submap_folder(const fs::path& folder, std::size_t number) {
  std::string digits = std::to_string(number);
  digits.insert(0, 6 - std::min<std::size_t>(6, digits.size()), '0');
  return folder / digits;
}

/// Points with their layout: of three floats, or of four doubles as old versions write them.
std::optional<std::pair<fs::path, BinLayout>> points_of(const fs::path& submap) {
  if (fs::is_regular_file(submap / "points_compact.bin"))
    return std::pair(submap / "points_compact.bin", BinLayout::kXyz);
  if (fs::is_regular_file(submap / "points.bin"))
    return std::pair(submap / "points.bin", BinLayout::kXyziDouble);
  return std::nullopt;
}

}  // namespace

GlimSubmap parse_glim_submap(std::string_view contents, const std::string& name, Problems& problems) {
  GlimSubmap submap;
  bool has_pose = false;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const std::string_view word = text::next_word(line);
    const text::Place place{name, lines.number()};
    const auto matrix = [&](const char* what) { return read_matrix(lines, name, what, problems); };
    if (word == "T_world_origin:") {
      submap.T_world_origin = matrix("T_world_origin");
      has_pose = true;
    } else if (word == "T_origin_endpoint_L:") {
      submap.T_origin_first = matrix("T_origin_endpoint_L");
    } else if (word == "T_origin_endpoint_R:") {
      submap.T_origin_last = matrix("T_origin_endpoint_R");
    } else if (word == "T_lidar_imu:") {
      submap.T_lidar_imu = matrix("T_lidar_imu");
    } else if (word == "T_odom_lidar:") {
      submap.T_odom_lidar.push_back(matrix("T_odom_lidar"));
    } else if (word == "stamp:") {
      const auto stamp = text::parse_seconds_ns(text::next_word(line));
      if (!stamp || !stamp_in_range(*stamp)) place.fail("needs a stamp in seconds");
      submap.stamps_ns.push_back(*stamp);
    }
  }
  if (!has_pose) throw InputError(name + ": has no T_world_origin");
  if (submap.T_odom_lidar.size() != submap.stamps_ns.size()) {
    throw InputError(name + ": has " + std::to_string(submap.stamps_ns.size()) + " stamps and " +
                     std::to_string(submap.T_odom_lidar.size()) + " poses T_odom_lidar of its frames");
  }
  return submap;
}

Mission read_glim(const fs::path& folder, const MissionOptions& options) {
  Problems problems;
  SavedFrames frames;
  frames.source = folder / "graph.txt";
  const Graph graph = read_graph_file(frames.source);
  problems.add("factor of GLIM's own graph left out",
               frames.source.string() + ": its closures are in graph.bin, which is not read", graph.factors);
  std::vector<GlimSubmap> submaps;
  bool all_stamps = true;
  for (std::size_t i = 0; i < graph.submaps; ++i) {
    const fs::path own = submap_folder(folder, i), file = own / "data.txt";
    if (!fs::is_regular_file(file)) {
      problems.add_altered("submap without data.txt left out", file.string());
      continue;
    }
    GlimSubmap submap = parse_glim_submap(read_file(file), file.string(), problems);
    frames.numbers.push_back(i);
    frames.poses.push_back(submap.T_world_origin);
    if (!submaps.empty()) frames.steps.push_back(step_between_submaps(submaps.back(), submap));
    all_stamps = all_stamps && !submap.stamps_ns.empty();
    // The origin of a submap is at its middle frame.
    if (all_stamps) frames.stamps_ns.push_back(submap.stamps_ns[submap.stamps_ns.size() / 2]);
    if (const auto points = points_of(own)) {
      if (frames.layout != BinLayout::kAuto && frames.layout != points->second) {
        throw InputError(points->first.string() +
                         ": its point format differs from that of the preceding submaps");
      }
      frames.layout = points->second;
      frames.clouds.emplace(i, points->first);
    }
    submaps.push_back(std::move(submap));
  }
  if (!all_stamps) frames.stamps_ns.clear();
  if (submaps.empty()) throw InputError(folder.string() + ": no submap in it: 000000/data.txt is missing");
  return mission_of_frames(frames, MissionKind::kGlim, folder, options, std::move(problems));
}

}  // namespace loopwise::parts
