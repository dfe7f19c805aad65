// SPDX-License-Identifier: BSD-3-Clause
// Replaces the readers of ROS 2 bags in a build without ROS 2 bags.
#include <loopwise/core/error.hpp>

#include "bag_storage.hpp"

namespace loopwise::bags {

bool rosbag2_available() {
  return false;
}

std::unique_ptr<Storage> open_rosbag2(const NumberedFile& file, const Opening&) {
  throw InputError(file.file.name + ": " + kRosbag2Unavailable);
}

}  // namespace loopwise::bags
