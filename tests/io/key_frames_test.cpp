// SPDX-License-Identifier: BSD-3-Clause
// Key frames out of odometry and sweeps.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/io/key_frames.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::key_frames_test {
namespace {

constexpr std::int64_t kStart_ns = 1'600'000'000'000'000'000;

std::int64_t stamp(double time_s) {
  return kStart_ns + static_cast<std::int64_t>(std::llround(time_s * 1e9));
}

/// Along a curve at 2 m/s and 0.1 rad/s.
Eigen::Isometry3d pose_after(double time_s) {
  Vector6d velocity;
  velocity << 2.0, 0.0, 0.0, 0.0, 0.0, 0.1;
  return se3::exp(velocity * time_s);
}

/// Odometry at 20 Hz, sweeps at 10 Hz in between, for 10 s.
RobotStream stream_of(const std::string& name = "husky") {
  RobotStream stream;
  stream.name = name;
  stream.source = name + ".bag";
  for (int i = 0; i <= 200; ++i) stream.odometry.push_back({stamp(0.05 * i), pose_after(0.05 * i)});
  for (int i = 0; i < 100; ++i) stream.sweep_stamps_ns.push_back(stamp(0.1 * i + 0.02));
  return stream;
}

CloudFile sweep_of(std::size_t stream, std::size_t sweep) {
  CloudFile file;
  file.cloud.points = {Eigen::Vector3f(1.0f, 0.0f, 0.0f),
                       Eigen::Vector3f(static_cast<float>(stream), static_cast<float>(sweep), 0.0f)};
  file.cloud.intensities = {1.0f, 2.0f};
  return file;
}

TEST_CASE("key frames: a sweep after every metre, with the pose at its stamp", "[io][key_frames]") {
  const RobotStream stream = stream_of();
  Problems problems;
  const std::vector<SelectedKeyFrame> frames = choose_key_frames(stream, {}, problems);
  CHECK(problems.empty());
  // 2 m/s and a sweep every 0.2 m: each sixth at the latest.
  REQUIRE(frames.size() >= 17);
  REQUIRE(frames.size() <= 20);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    CHECK(frames[i].stamp_ns == stream.sweep_stamps_ns[frames[i].sweep]);
    const double time_s = static_cast<double>(frames[i].stamp_ns - kStart_ns) * 1e-9;
    // Measured: 4e-9, of stamps in ns; the nearest pose would be 0.04 m off.
    CHECK(testing::difference(frames[i].pose, pose_after(time_s)) < 1e-7);
    CHECK(frames[i].submap.empty());
    if (i == 0) continue;
    const double step = (frames[i - 1].pose.inverse() * frames[i].pose).translation().norm();
    CHECK(step >= 1.0);
    CHECK(step < 1.21);
  }
}

TEST_CASE("key frames: by distance, by angle, of every sweep", "[io][key_frames]") {
  Problems problems;
  MissionOptions options;
  options.keyframe_distance_m = 1000.0;
  options.keyframe_angle_rad = 0.25;  // 1 rad in all
  CHECK(choose_key_frames(stream_of(), options, problems).size() == 4);
  options.keyframe_angle_rad = 0.0;
  CHECK(choose_key_frames(stream_of(), options, problems).size() == 100);
  options.keyframe_distance_m = 5.0;
  options.keyframe_angle_rad = 3.0;
  CHECK(choose_key_frames(stream_of(), options, problems).size() == 4);
  options.keyframe_distance_m = -1.0;
  CHECK_THROWS_WITH(make_key_frame_mission({stream_of()}, sweep_of, options),
                    Contains("keyframe_distance_m = -1"));
}

TEST_CASE("key frames: a mission of one stream", "[io][key_frames]") {
  const Mission mission = make_key_frame_mission({stream_of()}, sweep_of);
  REQUIRE(mission.robots.size() == 1);
  CHECK(mission.robots[0].name == "husky");
  const std::size_t nodes = mission.graph.nodes().size();
  CHECK(mission.graph.edges().size() == nodes - 1);
  for (const Edge& edge : mission.graph.edges()) {
    CHECK(edge.kind == EdgeKind::kOdometry);
    CHECK(edge.information.isApprox(odometry_information(edge.T_from_to), 1e-12));
  }
  CHECK(mission.graph.priors().size() == 1);
  CHECK(mission.start_ns == stamp(0.02));
  CHECK(mission.scans->size() == nodes);
  CHECK(mission.scans->load(1)->points[1].y() == 6.0f);  // the chord over five is a little below 1 m
  CHECK(mission.problems.empty());
}

TEST_CASE("key frames: robots by name, in the order given", "[io][key_frames]") {
  RobotStream away = stream_of("spot");
  for (StampedPose& pose : away.odometry) pose.pose = Eigen::Translation3d(50.0, 0.0, 0.0) * pose.pose;
  const Mission mission = make_key_frame_mission({stream_of("husky"), away}, sweep_of);
  REQUIRE(mission.robots.size() == 2);
  CHECK(mission.robots[0].name == "husky");
  CHECK(mission.robots[1].name == "spot");
  CHECK(mission.graph.contains(make_key('b', 0)));
  CHECK(mission.graph.priors().size() == 2);
  CHECK(mission.scans->load(make_key('b', 0))->points[1].x() == 1.0f);
  CHECK(mission.problems.count("joined without a frame") == 0);
  const Mission both = make_key_frame_mission({stream_of("husky"), stream_of("spot")}, sweep_of);
  CHECK(both.problems.count("joined without a frame") == 2);
  CHECK_THROWS_WITH(make_key_frame_mission({stream_of(), stream_of()}, sweep_of),
                    Contains("husky") && Contains("twice"));
  CHECK_THROWS_AS(make_key_frame_mission({}, sweep_of), InputError);
}

TEST_CASE("key frames: flaws of stamps and poses are counted", "[io][key_frames]") {
  RobotStream stream = stream_of();
  std::swap(stream.odometry[10], stream.odometry[11]);
  stream.odometry.push_back(stream.odometry.back());
  std::swap(stream.sweep_stamps_ns[20], stream.sweep_stamps_ns[21]);
  stream.sweep_stamps_ns[30] = stream.sweep_stamps_ns[29];
  stream.odometry[50].pose.translation().x() = std::numeric_limits<double>::quiet_NaN();
  stream.odometry[51].stamp_ns = std::numeric_limits<std::int64_t>::max();
  stream.sweep_stamps_ns[40] = std::numeric_limits<std::int64_t>::min();
  stream.sweep_stamps_ns.push_back(stamp(12.0));
  stream.odometry.push_back({stamp(15.0), pose_after(10.0)});
  Problems problems;
  const std::vector<SelectedKeyFrame> frames = choose_key_frames(stream, {}, problems);
  CHECK(problems.count("odometry stamps run backwards, sorted") == 1);
  CHECK(problems.count("odometry pose of a repeated stamp left out") == 1);
  CHECK(problems.count("sweep stamps run backwards, sorted") == 1);
  CHECK(problems.count("sweep of a repeated stamp left out") == 1);
  CHECK(problems.count("odometry pose not finite left out") == 1);
  CHECK(problems.count("stamp out of range left out") == 2);
  CHECK(problems.count("sweep without odometry near in time left out") == 1);
  CHECK(problems.count("odometry pose without a sweep near in time") == 1);
  for (const SelectedKeyFrame& frame : frames) {
    const double time_s = static_cast<double>(frame.stamp_ns - kStart_ns) * 1e-9;
    CHECK(testing::difference(frame.pose, pose_after(time_s)) < 1e-7);
  }
  CHECK_THROWS_WITH(require_unaltered(problems), Contains("strict"));
}

TEST_CASE("key frames: gaps and jumps of the odometry are counted", "[io][key_frames]") {
  RobotStream gap = stream_of();
  gap.odometry.erase(gap.odometry.begin() + 80, gap.odometry.begin() + 120);
  Problems problems;
  static_cast<void>(choose_key_frames(gap, {}, problems));
  CHECK(problems.count("gap in the odometry") == 1);
  CHECK(problems.count("gap in the sweeps") == 1);
  CHECK(problems.count("odometry jumps") == 0);

  RobotStream standing = gap;  // a robot that stands and says nothing misses nothing
  for (StampedPose& pose : standing.odometry) pose.pose.translation().setZero();
  Problems of_standing;
  static_cast<void>(choose_key_frames(standing, {}, of_standing));
  CHECK(of_standing.count("gap in the odometry") == 0);

  RobotStream jump = stream_of();
  for (std::size_t i = 100; i < jump.odometry.size(); ++i) jump.odometry[i].pose.translation().y() += 20.0;
  Problems of_jump;
  static_cast<void>(choose_key_frames(jump, {}, of_jump));
  CHECK(of_jump.count("odometry jumps") == 1);
}

TEST_CASE("key frames: odometry of few poses", "[io][key_frames]") {
  RobotStream stream = stream_of();
  stream.odometry.clear();
  for (int i = 0; i <= 10; ++i) stream.odometry.push_back({stamp(i), pose_after(i)});
  MissionOptions options;
  options.keyframe_distance_m = 0.0;
  Problems problems;
  // Of ten sweeps a second those at 0.02, 0.92 and 1.02 s are near enough to a pose.
  const std::vector<SelectedKeyFrame> frames = choose_key_frames(stream, options, problems);
  CHECK(frames.size() == 20);
  for (const SelectedKeyFrame& frame : frames) {
    const double time_s = static_cast<double>(frame.stamp_ns - kStart_ns) * 1e-9;
    // Even motion lies between the poses exactly; the nearest pose would be 0.16 m off.
    CHECK(testing::difference(frame.pose, pose_after(time_s)) < 1e-7);
  }
  CHECK(problems.count("sweep without odometry near in time left out") == 80);
  CHECK(problems.count("sweep with the pose of another time") == 0);

  stream.odometry.erase(stream.odometry.begin() + 5);
  Problems of_gap;
  static_cast<void>(choose_key_frames(stream, options, of_gap));
  CHECK(of_gap.count("sweep with the pose of another time") == 2);  // at 4.02 and 5.92 s
}

TEST_CASE("key frames: unrelated clocks", "[io][key_frames]") {
  RobotStream stream = stream_of();
  for (std::int64_t& ns : stream.sweep_stamps_ns) ns -= kStart_ns;
  Problems problems;
  CHECK_THROWS_WITH(choose_key_frames(stream, {}, problems),
                    Contains("husky.bag") && Contains("1600000000.0") && Contains("9.92") &&
                        Contains("keyframe_max_time_difference_s"));
  stream.sweep_stamps_ns.clear();
  CHECK_THROWS_WITH(choose_key_frames(stream, {}, problems), Contains("0 sweeps"));
}

TEST_CASE("key frames: sweeps between them make a submap", "[io][key_frames][submap]") {
  MissionOptions options;
  options.submap_sweeps = 100;
  Problems problems;
  const RobotStream stream = stream_of();
  const std::vector<SelectedKeyFrame> frames = choose_key_frames(stream, options, problems);
  std::size_t used = 0;
  for (const SelectedKeyFrame& frame : frames) {
    used += frame.submap.size();
    for (const SubmapSweep& part : frame.submap) {
      const double time_s = static_cast<double>(stream.sweep_stamps_ns[part.sweep] - frame.stamp_ns) * 1e-9;
      CHECK(testing::difference(part.T_key_sweep, pose_after(time_s)) < 1e-7);
      CHECK(std::abs(time_s) < 0.61);
    }
  }
  CHECK(used == 100);
  options.submap_sweeps = 3;
  for (const SelectedKeyFrame& frame : choose_key_frames(stream, options, problems)) {
    CHECK(frame.submap.size() <= 3);
    CHECK(std::any_of(frame.submap.begin(), frame.submap.end(),
                      [&](const SubmapSweep& part) { return part.sweep == frame.sweep; }));
  }
  CHECK(problems.count("sweep beyond submap_sweeps left out of a submap") > 0);
}

TEST_CASE("key frames: the scan of a submap is read on demand", "[io][key_frames][submap]") {
  MissionOptions options;
  options.submap_sweeps = 100;
  auto reads = std::make_shared<std::atomic<int>>(0);
  const auto read = [reads](std::size_t stream, std::size_t sweep) {
    ++*reads;
    if (sweep == 7 || sweep == 12) throw InputError("sweep " + std::to_string(sweep) + " is cut short");
    return sweep_of(stream, sweep);
  };
  Problems problems;
  const std::vector<SelectedKeyFrame> frames = choose_key_frames(stream_of(), options, problems);
  const Mission mission = make_key_frame_mission({stream_of()}, read, options);
  CHECK(*reads == 0);
  REQUIRE(frames[1].sweep == 6);
  REQUIRE(frames[2].sweep == 12);
  const auto scan = mission.scans->load(1);
  CHECK(scan->size() == 2 * (frames[1].submap.size() - 1));  // sweep 7 is damaged
  CHECK(scan->intensities.size() == scan->size());
  CHECK(mission.scans->problems().count("sweep of a submap cannot be read") == 1);
  const Eigen::Vector3f moved =
      frames[1].submap[0].T_key_sweep.cast<float>() * Eigen::Vector3f(1.0f, 0.0f, 0.0f);
  CHECK((scan->points[0] - moved).norm() < 1e-6f);
  CHECK_THROWS_WITH(mission.scans->load(2), Contains("sweep 12 is cut short"));
}

}  // namespace
}  // namespace loopwise::key_frames_test
