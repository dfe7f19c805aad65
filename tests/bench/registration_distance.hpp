// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <filesystem>

namespace loopwise::bench {

/// Registers pairs of a folder of scans with poses, drawn by their distance, without a guess and with the
/// source turned by a random yaw, and prints a row for each 10 m up to 40 m. \param count pairs of a row
/// \param pcl_every PCL registers every n-th of them beside; 0: none
void distance(const std::filesystem::path& folder, std::uint64_t count, std::uint64_t pcl_every);

}  // namespace loopwise::bench
