// SPDX-License-Identifier: BSD-3-Clause
// Replaces bag_rosbag.cpp in a build without ROS 1 bags.
#include <loopwise/core/error.hpp>

#include "bag_storage.hpp"

namespace loopwise::bags {

bool available() {
  return false;
}

std::unique_ptr<Storage> open_rosbags(const std::vector<NumberedFile>& files, const Opening&) {
  throw InputError(files.front().file.name + ": " + kUnavailable);
}

}  // namespace loopwise::bags
