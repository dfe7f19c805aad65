// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Folders of sweeps as data sets have them, with the poses of the sensor in a file. Private to io.
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

/// What the name of a cloud says of when it was taken: digits that count s, ms, µs or ns since 1970, decimal
/// seconds, or SECONDS_NANOSECONDS, behind any word. Nothing of names that number clouds.
[[nodiscard]] std::optional<std::int64_t> stamp_of_name(std::string_view stem);
/// The folder, or the only folder in it, whose clouds are named by stamps; empty if no folder has such
/// clouds. \throws InputError if there are several
[[nodiscard]] std::filesystem::path stamped_clouds_of(const std::filesystem::path& folder);
/// Clouds named by their stamps, and a trajectory in TUM's form: options.poses, else the only one in the
/// folder or beside the clouds.
[[nodiscard]] Mission read_stamped_clouds(const std::filesystem::path& folder, const MissionOptions& options);

/// A trajectory in TUM's form as data sets write it too: separated by commas, stamps in s, ms, µs or ns as
/// their digits tell, or seconds and nanoseconds in two columns, a first line of names. \throws as
/// parse_trajectory()
[[nodiscard]] Trajectory parse_stamped_poses(const std::string& contents, const std::string& name);

}  // namespace loopwise::parts
