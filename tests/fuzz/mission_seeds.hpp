// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Small missions, runs and studies on disk, around the one file that a fuzzer writes.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace loopwise::fuzz {

/// Folder and file. Findings depend on the order: append new ones at the end.
using SeedFiles = std::vector<std::pair<std::string, std::string>>;

/// mission/, session/, session2/, g2o_pcd/ and those of write_seed_saved_maps().
void write_seed_missions(const std::filesystem::path& folder);
[[nodiscard]] const SeedFiles& seed_mission_files();

/// kitti/, stamped/, glim/, fast_lio/, hba/, voxel/, kiss/, mrg/ and open3d/.
void write_seed_saved_maps(const std::filesystem::path& folder);

/// run/ and study/, as `loopwise replay` and `loopwise study` leave them.
void write_seed_runs(const std::filesystem::path& folder);
[[nodiscard]] const SeedFiles& seed_run_files();

}  // namespace loopwise::fuzz
