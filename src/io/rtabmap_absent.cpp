// SPDX-License-Identifier: BSD-3-Clause
// Replaces the reader of RTAB-Map's databases in a build without SQLite.
#include <loopwise/core/error.hpp>

#include "bag_storage.hpp"
#include "rtabmap.hpp"

namespace loopwise::parts {

bool is_rtabmap_database(const std::filesystem::path& file) {
  return file.extension() == ".db";
}

Mission read_rtabmap(const std::filesystem::path& path, const MissionOptions&, const Work&) {
  throw InputError(path.string() + ": " + bags::kRosbag2Unavailable);
}

}  // namespace loopwise::parts
