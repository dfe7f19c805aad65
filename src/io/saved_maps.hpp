// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Reads key frames or submaps of other SLAM programs, with their poses. Private to io.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>

#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise::parts {

/// The kind of the folder, if one of these programs wrote it. \throws IoError
[[nodiscard]] std::optional<MissionKind> saved_map_kind(const std::filesystem::path& folder);
/// Reads a folder, or for kOpen3d also a file, of one of these kinds. \throws as read_mission()
[[nodiscard]] Mission read_saved_map(MissionKind kind, const std::filesystem::path& path,
                                     const MissionOptions& options);

/// Frames of one robot with poses that the program optimised.
struct SavedFrames {
  std::filesystem::path source;          ///< File of the poses, for problems.
  std::vector<Key> numbers;              ///< The program's number of each frame, ascending; its key.
  std::vector<Eigen::Isometry3d> poses;  ///< T_world_frame.
  std::vector<std::int64_t> stamps_ns;   ///< Of each frame; empty if not known.
  /// Odometry from each frame to the next; computed from the poses where it is empty.
  std::vector<std::optional<Eigen::Isometry3d>> steps;
  std::map<Key, std::filesystem::path> clouds;  ///< By number.
  BinLayout layout = BinLayout::kAuto;          ///< Of clouds without a header.
};
/// Makes the mission. Poses of nodes follow odometry from the first pose, and the optimised poses are the
/// reference. Counts "odometry taken from the optimised poses" for missing steps.
[[nodiscard]] Mission mission_of_frames(const SavedFrames& frames, MissionKind kind,
                                        const std::filesystem::path& folder, const MissionOptions& options,
                                        Problems problems);

/// Clouds of a folder whose whole name is a number, by this number. Counts foreign files.
[[nodiscard]] std::map<Key, std::filesystem::path> numbered_clouds(const std::filesystem::path& folder,
                                                                   Problems& problems);

/// A submap according to GLIM's data.txt.
struct GlimSubmap {
  Eigen::Isometry3d T_world_origin = Eigen::Isometry3d::Identity();  ///< Optimised.
  Eigen::Isometry3d T_origin_first = Eigen::Isometry3d::Identity();  ///< Its first frame, of the IMU.
  Eigen::Isometry3d T_origin_last = Eigen::Isometry3d::Identity();   ///< Its last frame, of the IMU.
  Eigen::Isometry3d T_lidar_imu = Eigen::Isometry3d::Identity();
  std::vector<std::int64_t> stamps_ns;          ///< Of its frames.
  std::vector<Eigen::Isometry3d> T_odom_lidar;  ///< Of its frames, by odometry alone.
};
/// \throws ParseError naming `name` and the line
[[nodiscard]] GlimSubmap parse_glim_submap(std::string_view contents, const std::string& name,
                                           Problems& problems);
/// Reads graph.txt, NUMBER/data.txt and NUMBER/points_compact.bin. Submaps are the nodes.
[[nodiscard]] Mission read_glim(const std::filesystem::path& folder, const MissionOptions& options);

/// Reads alidarState.txt and NUMBER.pcd of one session, or edge.txt and a folder for each session.
[[nodiscard]] Mission read_voxel_slam(const std::filesystem::path& folder, const MissionOptions& options);

/// Reads local_map_graph.g2o and plys/NUMBER.ply, which are in world coordinates.
[[nodiscard]] Mission read_kiss_slam(const std::filesystem::path& folder, const MissionOptions& options);

/// Reads a pose graph of Open3D: the file, or a folder with the file and clouds whose names end with the
/// number of their node.
[[nodiscard]] Mission read_open3d(const std::filesystem::path& path, const MissionOptions& options);
/// Parses the graph. \throws ParseError or InputError naming `name` and the node or edge
[[nodiscard]] PoseGraph parse_open3d(std::string_view contents, const std::string& name, Problems& problems);
/// Whether a text begins like a pose graph of Open3D.
[[nodiscard]] bool looks_like_open3d(std::string_view beginning);

}  // namespace loopwise::parts
