// SPDX-License-Identifier: BSD-3-Clause
// A whole bag: our check, the library behind it, and the mission in it.
#include <rosbag/bag.h>

#include "bag.hpp"
#include "bag_check.hpp"
#include "checks.hpp"

LOOPWISE_FUZZ_TARGET(bag, bytes) {
  using namespace loopwise;
  // The library loads a plugin for its first bag and unloads it with its last, which takes longer than a bag.
  static const rosbag::Bag open_all_the_time;
  const auto file = fuzz::scratch() / "fuzz.bag";
  fuzz::put_file(file, bytes);
  Problems problems;
  const auto checked = fuzz::attempt([&] {
    bags::check_bag(file, "fuzz.bag", problems);
    return true;
  });
  fuzz::check_problems(problems);
  if (!checked && !fuzz::one_in(16, bytes)) return;  // the check comes first there as well
  const auto mission = fuzz::attempt([&] { return read_mission(file); });
  fuzz::expect(checked || !mission, "a bag that does not pass the check is not read");
  if (mission) fuzz::check_mission(*mission);
}
