// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Reads folders of sweeps of data sets, with the poses of the sensor in a file. Private to io.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include <loopwise/io/trajectory.hpp>

#include "mission_parts.hpp"

namespace loopwise::parts {

/// Whether the folder is a sequence of KITTI's odometry data: it has clouds in velodyne/.
[[nodiscard]] bool is_kitti_sequence(const std::filesystem::path& folder);
/// velodyne/NUMBER.bin, times.txt, calib.txt with Tr, and poses of the camera in poses.txt,
/// ../../poses/NAME.txt or options.poses.
[[nodiscard]] Mission read_kitti_sequence(const std::filesystem::path& folder, const MissionOptions& options);

/// Stamp in the name of a cloud: digits that count s, ms, µs or ns since 1970, decimal seconds, or
/// SECONDS_NANOSECONDS, after any word. Empty for names that number clouds.
[[nodiscard]] std::optional<std::int64_t> stamp_of_name(std::string_view stem);
/// The folder, or the only folder in it, with clouds that are named by stamps; empty if there are no such
/// clouds. \throws InputError if there are several folders
[[nodiscard]] std::filesystem::path stamped_clouds_of(const std::filesystem::path& folder);
/// Reads clouds that are named by their stamps, and a trajectory in TUM format: options.poses, otherwise the
/// only one in the folder or beside the clouds.
[[nodiscard]] Mission read_stamped_clouds(const std::filesystem::path& folder, const MissionOptions& options);

/// Parses a trajectory in TUM format, including variants that data sets use: separated by commas; stamps in
/// s, ms, µs or ns, which their digits show, or in two columns of seconds and nanoseconds; a first line of
/// names. \throws as parse_trajectory()
[[nodiscard]] Trajectory parse_stamped_poses(const std::string& contents, const std::string& name);

}  // namespace loopwise::parts
