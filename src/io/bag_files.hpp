// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Recognises bags, and the files of a folder that form a recording. Private to io.
#pragma once

#include <filesystem>
#include <vector>

#include <loopwise/core/problems.hpp>

namespace loopwise::bags {

/// Whether a file has the name of a bag: .bag of ROS 1; .db3 or .mcap of ROS 2, also compressed with zstd.
[[nodiscard]] bool is_bag_name(const std::filesystem::path& file);

/// Whether the folder is a bag of ROS 2: with the metadata.yaml of rosbag2, or with .db3 or .mcap files.
/// \throws IoError
[[nodiscard]] bool is_rosbag2_folder(const std::filesystem::path& folder);

/// Whether the folder contains bags, or folders that are bags. \throws IoError
[[nodiscard]] bool has_bags(const std::filesystem::path& folder);

/// Files of one recorder.
using Parts = std::vector<std::filesystem::path>;

/// The bags of a folder: its bags of ROS 1 together, the folder itself if it is a bag of ROS 2, and each of
/// its folders that is one. The metadata.yaml of rosbag2 lists the files of a bag. Without it, all files
/// belong to the bag; a compressed file with a decompressed copy is skipped. Counts "bag that was never
/// closed left out" and "bag not listed in metadata.yaml left out". \throws InputError naming a missing file
/// that metadata.yaml lists; IoError
[[nodiscard]] std::vector<Parts> bags_of_folder(const std::filesystem::path& folder, Problems& problems);

}  // namespace loopwise::bags
