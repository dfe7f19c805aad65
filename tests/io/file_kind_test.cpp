// SPDX-License-Identifier: BSD-3-Clause
// Files of other kinds that are given to readers: the error names the kind and the remedy.
#include "file_kind.hpp"

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::file_kind_test {
namespace {

namespace fs = std::filesystem;
using namespace std::string_literals;
using testing::TemporaryFolder;

const std::string kPointer =
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\nsize 12345\n";
const std::string kDatabase = "SQLite format 3\0\x10\0\1\1\0\x40  "s;

TEST_CASE("file kinds: by their first bytes", "[io][file_kind]") {
  CHECK(file_kind("") == FileKind::kEmpty);
  CHECK(file_kind(kPointer) == FileKind::kGitLfsPointer);
  CHECK(file_kind("/annex/objects/SHA256E-s1--0.pcd\n") == FileKind::kGitAnnexPointer);
  CHECK(file_kind(kDatabase) == FileKind::kSqlite);
  CHECK(file_kind("\x89MCAP0\r\n more") == FileKind::kMcap);
  CHECK(file_kind("#ROSBAG V2.0\n") == FileKind::kBag);
  CHECK(file_kind("# .PCD v0.7 - Point Cloud Data file format\n") == FileKind::kPcd);
  CHECK(file_kind("ply\nformat ascii 1.0\n") == FileKind::kPly);
  CHECK(file_kind("LASF\0\0\0\0"s) == FileKind::kLas);
  CHECK(file_kind("\x93NUMPY\1\0v\0"s) == FileKind::kNumpy);
  CHECK(file_kind("PK\x03\x04...") == FileKind::kZip);
  CHECK(file_kind("\x1f\x8b\x08\0"s) == FileKind::kCompressed);
  CHECK(file_kind(std::string(257, 'x') + "ustar\0"s) == FileKind::kTar);
  CHECK(file_kind("\n <!DOCTYPE html>\n") == FileKind::kMarkup);
  CHECK(file_kind("{\"a\": 1}") == FileKind::kJson);
  CHECK(file_kind("rosbag2_bagfile_information:\n  version: 5\n") == FileKind::kYaml);
  CHECK(file_kind("# a comment\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n") == FileKind::kG2o);
  CHECK(file_kind("# stamp\n1.5 1 2 3 0 0 0 1\n") == FileKind::kTum);
  CHECK(file_kind("1 0 0 4 0 1 0 5 0 0 1 6\n") == FileKind::kKitti);
  CHECK(file_kind("1 0 0 4 0 1 0 5 0 0 1 x\n") == FileKind::kUnknown);
  CHECK(file_kind("key,stamp_ns\n") == FileKind::kUnknown);
  CHECK(file_kind("\1\2\0\3"s) == FileKind::kUnknown);
  CHECK(file_kind("PK") == FileKind::kUnknown);  // too short to recognise
}

TEST_CASE("file kinds: readers name the kind of the given file", "[io][file_kind][error]") {
  const TemporaryFolder folder;
  struct Foreign {
    std::string contents;
    std::string what;
    std::string advice;
  };
  const Foreign foreign = GENERATE(values<Foreign>({
      {kPointer, "a pointer of Git LFS", "git lfs pull"},
      {kDatabase, "an SQLite database", "give it as a mission"},
      {"\x89MCAP0\r\n", "an MCAP recording", "give it as a mission"},
      {"LASF\0\0\0\0"s, "a LAS or LAZ cloud", "pdal translate"},
      {"\x93NUMPY\1\0v\0"s, "an array of NumPy", "PCD or PLY"},
  }));
  CAPTURE(foreign.what);
  const fs::path file = folder / "given";
  testing::write_text(file, foreign.contents);
  const auto refuses = [&](auto&& read) {
    std::string message = "read";
    try {
      read();
    } catch (const InputError& error) {
      message = error.what();
    }
    CHECK_THAT(message,
               Contains("given: is " + foreign.what) && Contains("expected ") && Contains(foreign.advice));
  };
  if (Contains("as a mission").match(foreign.advice)) {
    CHECK(mission_kind(file) == MissionKind::kBags);
    CHECK_THROWS_WITH(read_mission(file), Contains("given: "));
  } else {
    refuses([&] { return read_mission(file); });
    refuses([&] { return mission_kind(file); });
  }
  refuses([&] { return read_g2o(file); });
  refuses([&] { return read_trajectory(file); });
  refuses([&] { return read_trajectory(file, TrajectoryFormat::kKitti); });
  refuses([&] { return read_transform(file); });
  refuses([&] { return read_cloud(file); });
  refuses([&] { return CsvTable(file, {"key", "stamp_ns"}); });
  refuses([&] { return read_json_file(file); });
  if (foreign.what != "a LAS or LAZ cloud") {  // whose four bytes may be a number
    testing::write_text(folder / "given.bin", foreign.contents);
    CHECK_THROWS_WITH(read_cloud(folder / "given.bin"), Contains("given.bin: is " + foreign.what));
  }
  for (const char* name : {"given.pcd", "given.ply"}) {
    testing::write_text(folder / name, foreign.contents);
    CHECK_THROWS_WITH(read_cloud(folder / name), Contains(name + ": is "s + foreign.what));
  }
}

TEST_CASE("file kinds: Loopwise's own kinds in the wrong place", "[io][file_kind][error]") {
  const TemporaryFolder folder;
  write_ply(folder / "a.ply", testing::random_cloud(5, false, false));
  write_pcd(folder / "a.pcd", testing::random_cloud(5, false, false));
  testing::write_text(folder / "a.tum", "1.5 1 2 3 0 0 0 1\n");
  testing::write_text(folder / "a.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n");
  testing::write_text(folder / "empty.bag", "");
  testing::write_text(folder / "old.bag", "#ROSLOG V1.1\n0001");
  testing::write_text(folder / "pointer.bag", kPointer);
  CHECK_THROWS_WITH(read_mission(folder / "a.ply"), Contains("is a PLY cloud, expected a mission"));
  CHECK_THROWS_WITH(read_mission(folder / "a.pcd"), Contains("is a PCD cloud, expected a mission"));
  CHECK_THROWS_WITH(read_mission(folder / "a.tum"), Contains("TUM") && Contains("loopwise evaluate"));
  CHECK_THROWS_WITH(read_mission(folder / "old.bag"),
                    Contains("old version") && Contains("convert it to version 2.0 with 'rosbag fix'"));
  CHECK_THROWS_WITH(read_mission(folder / "empty.bag"), Contains("empty.bag: is empty"));
  CHECK_THROWS_WITH(read_mission(folder / "pointer.bag"), Contains("git lfs pull"));
  CHECK_THROWS_WITH(read_transform(folder / "a.g2o"), Contains("is a g2o graph"));
  CHECK_THROWS_WITH(static_cast<void>(read_json_file(folder / "a.g2o")),
                    Contains("is a g2o graph, expected JSON"));
  fs::rename(folder / "a.ply", folder / "b.pcd");
  CHECK_THROWS_WITH(read_cloud(folder / "b.pcd"), Contains("is a PLY cloud, expected a PCD cloud"));

  // Among other files of a folder as well.
  fs::create_directories(folder / "bags");
  fs::rename(folder / "pointer.bag", folder / "bags" / "robot.bag");
  CHECK_THROWS_WITH(read_mission(folder / "bags"), Contains("robot.bag: is a pointer of Git LFS"));
}

TEST_CASE("file kinds: points whose numbers look like a mark are points", "[io][file_kind]") {
  const TemporaryFolder folder;
  for (const std::string& mark : {"LASF"s, "PK\x03\x04"s, "\x1f\x8b\x08\x01"s, "BZh9"s}) {
    testing::write_text(folder / "a.bin", mark + std::string(12, '\x01'));
    CHECK(read_cloud(folder / "a.bin").cloud.size() == 1);
  }
}

TEST_CASE("file kinds: folders of other data are named", "[io][file_kind][error]") {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& what, const std::string& advice) {
    CHECK_THROWS_AS(read_mission(folder.path()), InputError);
    CHECK_THROWS_WITH(read_mission(folder.path()),
                      Contains("is not a mission: it " + what) && Contains(advice));
  };
  refused("is an empty folder", "empty");
  SECTION("a broken recording of ROS 2") {
    testing::write_text(folder / "metadata.yaml", "rosbag2_bagfile_information:\n");
    CHECK_THROWS_WITH(read_mission(folder.path()), Contains("no bag in it"));
    testing::write_text(folder / "run_0.db3", kDatabase);
    fs::remove(folder / "metadata.yaml");
    CHECK_THROWS_WITH(read_mission(folder.path()), Contains("run_0.db3"));
  }
  SECTION("a sequence of KITTI") {
    fs::create_directories(folder / "velodyne");
    testing::write_text(folder / "calib.txt", "P0: 1 2 3\n");
    testing::write_text(folder / "times.txt", "0\n");
    refused("has KITTI's odometry data", "velodyne/NUMBER.bin");
    fs::rename(folder / "velodyne", folder / "image_2");
    refused("has KITTI's odometry data", "velodyne/NUMBER.bin");
  }
  SECTION("all of KITTI") {
    fs::create_directories(folder / "sequences" / "00");
    refused("has KITTI's odometry data", "sequences/00");
  }
  SECTION("a map of LIO-SAM") {
    for (const char* name : {"trajectory", "transformations", "GlobalMap", "CornerMap", "SurfMap"})
      write_pcd(folder / (std::string(name) + ".pcd"), testing::random_cloud(5, false, true));
    refused("is a map saved by LIO-SAM, which does not save the scans", "SC-LIO-SAM");
  }
  SECTION("exports of RTAB-Map without its database") {
    write_ply(folder / "lab_cloud.ply", testing::random_cloud(5, false, false));
    testing::write_text(folder / "lab_poses.txt",
                        "#timestamp x y z qx qy qz qw id\n1.5 0 0 0 0 0 0 1 1\n2.5 1 0 0 0 0 0 1 2\n");
    refused("has poses written by rtabmap-export", "give its .db");
  }
  SECTION("clouds alone") {
    write_ply(folder / "a.ply", testing::random_cloud(5, false, false));
    refused("has clouds without poses", "odom_poses.txt");
  }
}

}  // namespace
}  // namespace loopwise::file_kind_test
