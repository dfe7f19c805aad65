// SPDX-License-Identifier: BSD-3-Clause
// Folders of sweeps: KITTI's layout, and clouds named by stamps beside a trajectory.
#include <loopwise/core/error.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

#include "raw_sequence.hpp"
#include "raw_sequence_data.hpp"

namespace loopwise::raw_sequence_test {
namespace {

namespace fs = std::filesystem;
using testing::TemporaryFolder;

constexpr std::int64_t kStart_ns = 1'561'000'444'390'857'630;

std::vector<std::int64_t> stamps_of(std::size_t count) {
  std::vector<std::int64_t> stamps;
  for (std::size_t i = 0; i < count; ++i)
    stamps.push_back(kStart_ns + static_cast<std::int64_t>(i) * 100'003'000);
  return stamps;
}

/// Each node stands where the lidar was when its scan, which knows its number, was taken.
void check_nodes(const Mission& mission, const std::vector<Eigen::Isometry3d>& lidar, double tolerance) {
  for (const Node& node : mission.graph.nodes()) {
    const auto sweep = static_cast<std::size_t>(mission.scans->load(node.key)->points[0].x());
    REQUIRE(sweep < lidar.size());
    CHECK(testing::difference(node.pose, lidar[sweep]) < tolerance);
  }
}

TEST_CASE("KITTI: poses of the camera become those of the lidar", "[io][kitti]") {
  const TemporaryFolder folder;
  testing::write_kitti_sequence(folder / "07", 40);
  const Mission mission = read_mission(folder / "07");
  CHECK(mission.kind == MissionKind::kKitti);
  CHECK(mission.name == "07");
  CHECK(mission.graph.nodes().size() == 20);  // a sweep each 0.8 m, a key frame after 1 m
  CHECK(mission.graph.edges().size() == 19);
  // Measured: 4e-12; poses taken for the lidar's are 30 m off.
  check_nodes(mission, testing::car_drive(40), 1e-9);
  CHECK(mission.graph.node(1).stamp_ns == 206'000'000);
  CHECK(mission.problems.count("odometry taken from the poses of the data set") == 1);
  CHECK(mission.problems.all().size() == 1);
  MissionOptions options;
  options.keyframe_distance_m = 0.0;
  options.strict = true;
  CHECK(read_mission(folder / "07", options).graph.nodes().size() == 40);
}

TEST_CASE("KITTI: poses in the folder of the data set, and those of an odometry", "[io][kitti]") {
  const TemporaryFolder folder;
  const fs::path sequence = folder / "dataset" / "sequences" / "00";
  testing::write_kitti_sequence(sequence, 40);
  fs::create_directories(folder / "dataset" / "poses");
  fs::rename(sequence / "poses.txt", folder / "dataset" / "poses" / "00.txt");
  CHECK(read_mission(sequence).graph.nodes().size() == 20);

  std::vector<Eigen::Isometry3d> drifting;
  const Eigen::Isometry3d Tr = testing::T_camera_lidar();
  std::vector<Eigen::Isometry3d> lidar = testing::car_drive(40);
  for (std::size_t i = 0; i < lidar.size(); ++i) {
    lidar[i].translation().y() += 0.01 * static_cast<double>(i);
    drifting.push_back(Tr * lidar[i] * Tr.inverse());
  }
  testing::write_text(folder / "odometry.txt", testing::kitti_rows(drifting));
  MissionOptions options;
  options.poses = folder / "odometry.txt";
  const Mission mission = read_mission(sequence, options);
  check_nodes(mission, lidar, 1e-3);  // six digits of 30 m
  REQUIRE(mission.ground_truth.size() == mission.graph.nodes().size());
  const std::vector<Eigen::Isometry3d> truth = testing::car_drive(40);
  for (const auto& [key, pose] : mission.ground_truth) {
    const auto sweep = static_cast<std::size_t>(mission.scans->load(key)->points[0].x());
    CHECK(testing::difference(pose, truth[sweep]) < 1e-9);
  }
  CHECK(mission.problems.count("poses of the data set used as the truth") == 1);
}

TEST_CASE("KITTI: flaws of a sequence are counted or errors", "[io][kitti][error]") {
  const TemporaryFolder folder;
  const fs::path sequence = folder / "07";
  testing::write_kitti_sequence(sequence, 40);
  SECTION("poses are missing") {
    fs::remove(sequence / "poses.txt");
    CHECK_THROWS_WITH(read_mission(sequence), Contains("no poses") && Contains("--poses"));
  }
  SECTION("no calibration: the poses are those of a camera, which looks along z") {
    fs::remove(sequence / "calib.txt");
    const Mission mission = read_mission(sequence);
    CHECK(mission.problems.count("no calibration given") == 1);
    CHECK(mission.problems.count("lidar does not move along its x axis") == 1);
  }
  SECTION("poses of the lidar where those of the camera are expected") {
    testing::write_text(sequence / "poses.txt", testing::scientific_rows(testing::car_drive(40)));
    CHECK(read_mission(sequence).problems.count("lidar does not move along its x axis") == 1);
  }
  SECTION("files of different length, sweeps that are missing, no times") {
    testing::write_text(sequence / "times.txt", "0\n0.1\n0.2\n0.3\n0.4\n0.5\n0.6\n0.7\n0.8\n0.9\n");
    CHECK(read_mission(sequence).problems.count("row beyond the common part left out") == 60);
    fs::remove(sequence / "times.txt");
    fs::remove(sequence / "velodyne" / "000003.bin");
    const Mission mission = read_mission(sequence);
    CHECK(mission.problems.count("no stamps given") == 1);
    check_nodes(mission, testing::car_drive(40), 1e-9);
  }
  SECTION("lines that are no pose, no time, no calibration") {
    testing::write_text(sequence / "times.txt", "0\nten\n");
    CHECK_THROWS_WITH(read_mission(sequence), Contains("times.txt:2") && Contains("not a stamp"));
    testing::write_text(sequence / "calib.txt", "P0: 1 2\nTr: 1 2 3\n");
    CHECK_THROWS_WITH(read_mission(sequence), Contains("calib.txt:2") && Contains("12 values"));
  }
}

TEST_CASE("stamped clouds: names contain the stamp", "[io][stamped_clouds]") {
  using parts::stamp_of_name;
  CHECK(stamp_of_name("1561000444390857630") == kStart_ns);
  CHECK(stamp_of_name("1561000444390857") == 1'561'000'444'390'857'000);
  CHECK(stamp_of_name("1561000444390") == 1'561'000'444'390'000'000);
  CHECK(stamp_of_name("1561000444") == 1'561'000'444'000'000'000);
  CHECK(stamp_of_name("1561000444.390857630") == kStart_ns);
  CHECK(stamp_of_name("1561000444.39") == 1'561'000'444'390'000'000);
  CHECK(stamp_of_name("cloud_1583836591_182590976") == 1'583'836'591'182'590'976);
  CHECK(stamp_of_name("1583836591_82590976") == 1'583'836'591'082'590'976);
  for (const char* name : {"000012", "12", "map", "", "scan_000012", "99999999999999999999", "1.5",
                           "1561000444_1234567890", "1561000444.39.2"}) {
    CAPTURE(name);
    CHECK_FALSE(stamp_of_name(name));
  }
}

/// Clouds named by `name_of`, in a subfolder.
template <class Name>
void write_clouds(const fs::path& folder, const std::vector<std::int64_t>& stamps, const Name& name_of) {
  fs::create_directories(folder);
  for (std::size_t i = 0; i < stamps.size(); ++i) testing::write_kitti_bin(folder / name_of(stamps[i]), i);
}

TEST_CASE("stamped clouds: a trajectory beside them", "[io][stamped_clouds]") {
  const TemporaryFolder folder;
  const std::vector<std::int64_t> stamps = stamps_of(40);
  write_clouds(folder / "run" / "Ouster", stamps,
               [](std::int64_t ns) { return std::to_string(ns) + ".bin"; });
  const std::string rows = testing::tum_rows(testing::car_drive(40), stamps);
  testing::write_text(folder / "run" / "odometry.txt", rows);
  testing::write_text(folder / "run" / "notes.txt", "made in June\n");
  const Mission mission = read_mission(folder / "run");
  CHECK(mission.kind == MissionKind::kStampedClouds);
  CHECK(mission.graph.nodes().size() == 20);
  check_nodes(mission, testing::car_drive(40), 1e-5);  // six decimals
  CHECK(mission.start_ns == kStart_ns);
  CHECK(mission.problems.empty());

  testing::write_text(folder / "run" / "truth.txt", rows);
  CHECK_THROWS_WITH(read_mission(folder / "run"),
                    Contains("odometry.txt and truth.txt") && Contains("--poses"));
  MissionOptions options;
  options.poses = folder / "run" / "odometry.txt";
  CHECK(read_mission(folder / "run", options).graph.nodes().size() == 20);
  options.poses = folder / "rows.txt";
  testing::write_text(options.poses, testing::kitti_rows(testing::car_drive(40)));
  CHECK_THROWS_WITH(read_mission(folder / "run", options), Contains("no stamps") && Contains("TUM"));
  fs::remove(folder / "run" / "truth.txt");
  fs::remove(folder / "run" / "odometry.txt");
  CHECK_THROWS_WITH(read_mission(folder / "run"), Contains("no poses") && Contains("--poses"));
  write_clouds(folder / "run" / "Avia", stamps, [](std::int64_t ns) { return std::to_string(ns) + ".bin"; });
  CHECK_THROWS_WITH(read_mission(folder / "run"), Contains("Avia/ and Ouster/"));
}

TEST_CASE("stamped clouds: forms of stamps in names and trajectories", "[io][stamped_clouds]") {
  const TemporaryFolder folder;
  const std::vector<std::int64_t> stamps = stamps_of(40);
  write_clouds(folder / "c", stamps, [](std::int64_t ns) {
    return "cloud_" + std::to_string(ns / 1'000'000'000) + "_" + std::to_string(ns % 1'000'000'000) + ".bin";
  });
  const std::vector<Eigen::Isometry3d> drive = testing::car_drive(40);
  std::string whole, pairs = "sec,nsec,x,y,z,qx,qy,qz,qw\n";
  for (std::size_t i = 0; i < drive.size(); ++i) {
    std::string pose = testing::decimals(drive[i]);
    whole += std::to_string(stamps[i]) + pose + "\n";
    std::replace(pose.begin(), pose.end(), ' ', ',');
    pairs += std::to_string(stamps[i] / 1'000'000'000) + "," + std::to_string(stamps[i] % 1'000'000'000) +
             pose + "\n";
  }
  for (const auto& [name, text] :
       {std::pair<std::string, std::string>{"ns.txt", whole}, {"pairs.csv", pairs}}) {
    CAPTURE(name);
    testing::write_text(folder / "c" / name, text);
    const Mission mission = read_mission(folder / "c");
    CHECK(mission.graph.nodes().size() == 20);
    check_nodes(mission, drive, 1e-5);
    fs::remove(folder / "c" / name);
  }
  testing::write_text(folder / "c" / "bad.txt", "1561000444390857630 1 2 3 0 0 0 1\n15 1 2 3 0 0 x 1\n");
  CHECK_THROWS_WITH(read_mission(folder / "c"), Contains("bad.txt:2"));
}

TEST_CASE("stamped clouds: joined with another run, and submaps", "[io][stamped_clouds]") {
  const TemporaryFolder folder;
  const std::vector<std::int64_t> stamps = stamps_of(40);
  for (const char* run : {"a", "b"}) {
    write_clouds(folder / run, stamps, [](std::int64_t ns) { return std::to_string(ns) + ".bin"; });
    testing::write_text(folder / run / "poses.txt", testing::tum_rows(testing::car_drive(40), stamps));
  }
  MissionOptions options;
  options.submap_sweeps = 4;
  const Mission mission = read_missions({folder / "a", folder / "b"}, options);
  CHECK(mission.robots.size() == 2);
  CHECK(mission.scans->size() == 40);
  CHECK(mission.scans->load(make_key('a', 3))->size() == 60);
  options.poses = folder / "a" / "poses.txt";
  CHECK_THROWS_WITH(read_missions({folder / "a", folder / "b"}, options),
                    Contains("one file is given for 2"));
  testing::write_fast_lio_slam(folder / "session", testing::drive(4));
  CHECK(read_mission(folder / "session", options).problems.count("file of poses not used") == 1);
}

}  // namespace
}  // namespace loopwise::raw_sequence_test
