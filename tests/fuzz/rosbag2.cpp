// SPDX-License-Identifier: BSD-3-Clause
// A whole bag of ROS 2, of either storage, and the mission in it.
#include "bag.hpp"
#include "checks.hpp"

LOOPWISE_FUZZ_TARGET(rosbag2, bytes) {
  using namespace loopwise;
  const auto file = fuzz::scratch() / "fuzz.mcap.zstd";
  fuzz::put_file(file, bytes);
  const auto mission = fuzz::attempt([&] { return read_mission(file); });
  if (mission) fuzz::check_mission(*mission);
}
