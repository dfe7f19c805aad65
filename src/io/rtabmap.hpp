// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Databases of RTAB-Map. Private to io.
#pragma once

#include <filesystem>
#include <vector>

#include "mission_parts.hpp"

namespace loopwise::parts {

/// Whether a file that begins as SQLite's do has the tables of RTAB-Map; of a build without SQLite by its
/// ending, `.db`.
[[nodiscard]] bool is_rtabmap_database(const std::filesystem::path& file);
/// Databases of RTAB-Map in a folder, by name. \throws IoError
[[nodiscard]] std::vector<std::filesystem::path> rtabmap_databases(const std::filesystem::path& folder);

/// Nodes at their odometry, links, lidar scans and optimised poses of the database, or of the only one in a
/// folder. Each of its maps is a robot. \throws IoError; InputError naming the file and the node;
/// StoppedError
[[nodiscard]] Mission read_rtabmap(const std::filesystem::path& path, const MissionOptions& options,
                                   const Work& work);

}  // namespace loopwise::parts
