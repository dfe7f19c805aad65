// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Databases of RTAB-Map. Private to io.
#pragma once

#include <filesystem>
#include <vector>

#include "mission_parts.hpp"

namespace loopwise::parts {

/// Whether a SQLite file has the tables of RTAB-Map. A build without SQLite decides by the ending `.db`.
[[nodiscard]] bool is_rtabmap_database(const std::filesystem::path& file);
/// Databases of RTAB-Map in a folder, by name. \throws IoError
[[nodiscard]] std::vector<std::filesystem::path> rtabmap_databases(const std::filesystem::path& folder);

/// Reads nodes at their odometry, links, lidar scans and optimised poses from the database, or from the only
/// one in a folder. Each map in it is a robot. \throws IoError; InputError naming the file and the node;
/// StoppedError
[[nodiscard]] Mission read_rtabmap(const std::filesystem::path& path, const MissionOptions& options,
                                   const Work& work);

}  // namespace loopwise::parts
