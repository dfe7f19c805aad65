// SPDX-License-Identifier: BSD-3-Clause
// The first byte chooses: a trajectory of any form, of one form, two to be paired, or a transform.
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/trajectory.hpp>

#include "checks.hpp"

namespace {

using namespace loopwise;

void check(const Trajectory& trajectory) {
  fuzz::expect(!trajectory.poses.empty(), "a trajectory has a pose");
  fuzz::expect(trajectory.keys.size() == trajectory.poses.size(), "a key for every pose");
  fuzz::expect(trajectory.stamps_ns.empty() || trajectory.stamps_ns.size() == trajectory.poses.size(),
               "a stamp for every pose or none");
  for (const Eigen::Isometry3d& pose : trajectory.poses) fuzz::check_pose(pose);
  fuzz::check_problems(trajectory.problems);
}

void write_and_read(const Trajectory& trajectory) {
  const auto file = fuzz::scratch() / "again.txt";
  if (trajectory.format == TrajectoryFormat::kG2o) return;
  if (trajectory.format == TrajectoryFormat::kTum) {
    std::vector<StampedPose> poses;
    for (std::size_t i = 0; i < trajectory.poses.size(); ++i) {
      poses.push_back({trajectory.stamps_ns[i], trajectory.poses[i]});
    }
    write_tum(file, poses);
  } else {
    write_kitti(file, trajectory.poses);
  }
  const Trajectory again = parse_trajectory(read_file(file), "again.txt", trajectory.format);
  fuzz::expect(again.stamps_ns == trajectory.stamps_ns, "written and read again: the same stamps");
  for (std::size_t i = 0; i < again.poses.size(); ++i) {
    fuzz::expect(again.poses[i].translation() == trajectory.poses[i].translation(),
                 "written and read again: the same places");
  }
}

}  // namespace

LOOPWISE_FUZZ_TARGET(trajectory, bytes) {
  const std::size_t choice = fuzz::take_choice(bytes, 6);
  if (choice == 5) {
    const auto pose = fuzz::attempt([&] { return parse_transform(bytes, "fuzz.txt"); });
    if (pose) fuzz::check_pose(*pose);
    return;
  }
  if (choice == 4) {  // two texts, parted by an empty byte
    const std::size_t end = std::min(bytes.find('\0'), bytes.size());
    const auto a = fuzz::attempt([&] { return parse_trajectory(bytes.substr(0, end), "a.txt"); });
    const auto b = fuzz::attempt(
        [&] { return parse_trajectory(bytes.substr(std::min(end + 1, bytes.size())), "b.txt"); });
    if (!a || !b) return;
    for (const double tolerance_s : {0.0, 0.02, 1e300}) {
      const auto pairs = fuzz::attempt([&] { return associate(*a, *b, tolerance_s); });
      if (!pairs) continue;
      fuzz::expect(!pairs->keys.empty() && pairs->keys.size() == pairs->estimate.size() &&
                       pairs->keys.size() == pairs->truth.size(),
                   "pairs have two poses and a key");
      fuzz::expect(pairs->keys.size() <= std::min(a->poses.size(), b->poses.size()),
                   "each pose is used once");
    }
    return;
  }
  const auto trajectory = fuzz::attempt([&] {
    return choice == 0 ? parse_trajectory(bytes, "fuzz.txt")
                       : parse_trajectory(bytes, "fuzz.txt", static_cast<TrajectoryFormat>(choice - 1));
  });
  if (!trajectory) return;
  check(*trajectory);
  write_and_read(*trajectory);
}
