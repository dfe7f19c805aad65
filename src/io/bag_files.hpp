// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Which files are bags, and which of a folder's files are a recording. Private to io.
#pragma once

#include <filesystem>
#include <vector>

#include <loopwise/core/problems.hpp>

namespace loopwise::bags {

/// Whether a file is called like a bag: .bag of ROS 1; .db3 or .mcap of ROS 2, packed by zstd or not.
[[nodiscard]] bool is_bag_name(const std::filesystem::path& file);

/// Whether the folder is a bag of ROS 2: with the metadata.yaml of rosbag2, or with .db3 or .mcap files.
/// \throws IoError
[[nodiscard]] bool is_rosbag2_folder(const std::filesystem::path& folder);

/// Whether the folder holds bags, or folders that are bags. \throws IoError
[[nodiscard]] bool has_bags(const std::filesystem::path& folder);

/// Files of one recorder.
using Parts = std::vector<std::filesystem::path>;

/// The bags of a folder: those of ROS 1 in it together, a bag of ROS 2 that it is, and each folder in it that
/// is one. The metadata.yaml of rosbag2 says which files belong to it; without, all do, of a packed file and
/// its copy that is not the latter. Counted: "bag that was never closed left out", "bag not listed in
/// metadata.yaml left out". \throws InputError naming a file that metadata.yaml lists and that is missing;
/// IoError
[[nodiscard]] std::vector<Parts> bags_of_folder(const std::filesystem::path& folder, Problems& problems);

}  // namespace loopwise::bags
