// SPDX-License-Identifier: BSD-3-Clause
// Stands in for bag_rosbag.cpp in a build without ROS bags.
#include <loopwise/core/error.hpp>

#include "bag.hpp"

namespace loopwise::bags {

struct BagSet::State {
  std::vector<Connection> connections;
};

bool available() {
  return false;
}

BagSet::BagSet(const std::vector<BagFile>& files, Problems&, const ProgressCallback&, const StopToken&)
    : state_(std::make_shared<State>()) {
  throw InputError((files.empty() ? std::string("ROS bags") : files.front().name) + ": " + kUnavailable);
}

const std::vector<Connection>& BagSet::connections() const {
  return state_->connections;
}

std::size_t BagSet::for_each(const Wanted&, const Visitor&, const ProgressCallback&, const StopToken&) {
  return 0;
}

BagSet::Kept BagSet::fetch(std::size_t) const {
  throw InputError(kUnavailable);
}

}  // namespace loopwise::bags
