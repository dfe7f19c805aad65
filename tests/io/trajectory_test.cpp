// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/trajectory.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include <loopwise/core/error.hpp>
#include <loopwise/io/g2o.hpp>

#include "testing.hpp"

namespace loopwise::trajectory_test {
namespace {

using testing::TemporaryFolder;

std::vector<StampedPose> random_poses(std::size_t count) {
  Rng rng(count);
  std::vector<StampedPose> poses;
  for (std::size_t i = 0; i < count; ++i) {
    poses.push_back(
        {1567410201745204735 + static_cast<std::int64_t>(i) * 123456789, testing::random_pose(rng, 100.0)});
  }
  return poses;
}

Trajectory read(const std::string& text) {
  const TemporaryFolder folder;
  testing::write_text(folder / "t.txt", text);
  return read_trajectory(folder / "t.txt");
}

Eigen::Isometry3d transform(const std::string& text) {
  const TemporaryFolder folder;
  testing::write_text(folder / "T.txt", text);
  return read_transform(folder / "T.txt");
}

TEST_CASE("trajectory: TUM keeps nanoseconds and poses", "[io][trajectory]") {
  auto poses = random_poses(20);
  poses.front().stamp_ns = -1500000001;
  const TemporaryFolder folder;
  write_tum(folder / "t.tum", poses);
  const auto back = read_tum(folder / "t.tum");
  REQUIRE(back.size() == poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    CHECK(back[i].stamp_ns == poses[i].stamp_ns);
    CHECK(testing::difference(back[i].pose, poses[i].pose) < 1e-13);  // measured: 9e-16
  }
  CHECK_THAT(testing::read_text(folder / "t.tum"),
             Contains("-1.500000001 ") && Contains("1567410201.868661524 "));
}

TEST_CASE("trajectory: KITTI keeps poses", "[io][trajectory]") {
  std::vector<Eigen::Isometry3d> poses;
  for (const auto& stamped : random_poses(20)) poses.push_back(stamped.pose);
  const TemporaryFolder folder;
  write_kitti(folder / "t.txt", poses);
  const auto back = read_kitti(folder / "t.txt");
  REQUIRE(back.size() == poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i)
    CHECK(testing::difference(back[i], poses[i]) < 1e-13);  // 1e-15
}

TEST_CASE("trajectory: the form is recognised by the contents", "[io][trajectory]") {
  CHECK(read("# stamp ...\n1.5 1 2 3 0 0 0 1\n").format == TrajectoryFormat::kTum);
  CHECK(read("\n1 0 0 1 0 1 0 2 0 0 1 3\n").format == TrajectoryFormat::kKitti);
  const Trajectory g2o = read("VERTEX_SE3:QUAT 6989586621679009793 1 2 3 0 0 0 1\n");
  CHECK(g2o.format == TrajectoryFormat::kG2o);
  CHECK(g2o.keys == std::vector<Key>{make_key('a', 1)});
  CHECK_THROWS_WITH(read("1 2 3\n"), Contains("t.txt:1: 3 values, expected 8"));
  CHECK_THROWS_WITH(read("# only this\n"), Contains("has no poses"));
  CHECK_THROWS_WITH(read(""), Contains("has no poses"));
}

TEST_CASE("trajectory: stamps in any notation are read to the nanosecond", "[io][trajectory]") {
  const std::string pose = " 0 0 0 0 0 0 1\n";
  CHECK(read("1567410201.7452047" + pose).stamps_ns[0] == 1567410201745204700);
  CHECK(read("1.5674102017452047e9" + pose).stamps_ns[0] == 1567410201745204700);
  CHECK(read("1.567410201745204700e+09" + pose).stamps_ns[0] == 1567410201745204700);
  CHECK(read("+0.0000000015" + pose).stamps_ns[0] == 2);
  CHECK(read("-15e-10" + pose).stamps_ns[0] == -2);
  CHECK(read("7" + pose).stamps_ns[0] == 7000000000);
  CHECK(read("1e-30" + pose).stamps_ns[0] == 0);
  CHECK_THROWS_WITH(read("1567410201745204700" + pose), Contains("is not a stamp in seconds"));
  CHECK_THROWS_WITH(read("x" + pose), Contains("is not a stamp in seconds"));
  CHECK_THROWS_WITH(read("nan" + pose), Contains("is not a stamp in seconds"));
}

TEST_CASE("trajectory: the id of a node may follow a TUM pose", "[io][trajectory]") {
  const Trajectory poses =
      read("#timestamp x y z qx qy qz qw id\n1.5 1 2 3 0 0 0 1 7\n2.5 1 2 4 0 0 0 1 8\n");
  CHECK(poses.format == TrajectoryFormat::kTum);
  CHECK(poses.poses.size() == 2);
  CHECK(poses.stamps_ns[1] == 2'500'000'000);
  CHECK_THROWS_WITH(read("1.5 1 2 3 0 0 0 1 7\n2.5 1 2 4 0 0 0 1 0.5\n"),
                    Contains("t.txt:2: a TUM pose needs 8 values"));
}

TEST_CASE("trajectory: bad poses are refused with their line, small flaws counted",
          "[io][trajectory][error]") {
  CHECK_THROWS_WITH(read("1 0 0 0 0 0 0 1\n2 0 nan 0 0 0 0 1\n"), Contains("t.txt:2: \"nan\" is not finite"));
  CHECK_THROWS_WITH(read("1 0 0 0 0 0 0 0\n"), Contains("t.txt:1: zero quaternion"));
  CHECK_THROWS_WITH(read("1 0 0 0 0 0 0 1\n2 0 0 0\n"),
                    Contains("t.txt:2: a TUM pose needs 8 values, found 4"));
  CHECK_THROWS_WITH(read("1 0 0 0 0 1 0 0 0 0 1 0\n1 0\n"),
                    Contains("t.txt:2: a KITTI pose needs 12 values, found 2"));
  CHECK_THROWS_WITH(read("2 0 0 0 0 1 0 0 0 0 1 0\n"), Contains("not a rotation matrix"));
  CHECK_THROWS_WITH(read("1 0 0 0 0 1 0 0 0 0 -1 0\n"), Contains("not a rotation matrix"));
  CHECK_THROWS_WITH(read("0 0 0 0 0 0 0 0 0 0 0 0\n"), Contains("not a rotation matrix"));
  CHECK(read("1 0 0 0 0 0 0 1.1\n").problems.count("non-unit quaternion") == 1);
  const Trajectory off = read("1.01 0 0 0 0 1 0 0 0 0 1 0\n");
  CHECK(off.problems.count("rotation not orthonormal") == 1);
  CHECK(off.poses[0].linear().isIdentity(1e-14));
}

TEST_CASE("trajectory: TUM poses are sorted by stamp, and flaws of stamps are counted", "[io][trajectory]") {
  const std::string pose = " 0 0 0 0 0 1\n";
  const char* const unsorted = "pose with a stamp before the preceding one, sorted";
  const char* const twice = "repeated stamp, perhaps written with too few digits";
  const char* const without_seconds = "stamps that may lack their seconds";
  Trajectory t = read("103 3" + pose + "101 1" + pose + "102 2" + pose + "100 0" + pose);
  for (std::size_t i = 0; i < 4; ++i) {
    CHECK(t.keys[i] == i);
    CHECK(t.stamps_ns[i] == static_cast<std::int64_t>(100 + i) * 1'000'000'000);
    CHECK(t.poses[i].translation().x() == static_cast<double>(i));
  }
  CHECK(t.problems.count(unsorted) == 2);
  CHECK_THAT(t.problems.all().front().example, Contains(":2: 101.000000000"));
  CHECK(t.problems.all().size() == 1);
  CHECK(read("0.1 1" + pose + "0.2 1" + pose).problems.empty());

  t = read("1.31188e+09 0" + pose + "1.31188e+09 1" + pose + "1.31188e+09 2" + pose + "1311880001 3" + pose);
  CHECK(t.problems.count(twice) == 2);
  CHECK(t.problems.count(unsorted) == 0);

  // 100.7, 100.9, 101.1 without the digits before the point.
  t = read(".7 0" + pose + ".9 1" + pose + ".1 2" + pose);
  CHECK(t.problems.count(without_seconds) == 1);
  CHECK(read("5.7 0" + pose + "5.9 1" + pose + "5.1 2" + pose).problems.count(without_seconds) == 0);
}

TEST_CASE("associate: stamps with too few digits are paired in their order, without listing all pairs",
          "[io][trajectory]") {
  constexpr std::size_t kPoses = 30000;  // as pairs, 20 GB
  Trajectory estimate;
  estimate.format = TrajectoryFormat::kTum;
  estimate.stamps_ns.assign(kPoses, 1600000000000000000);
  estimate.poses.assign(kPoses, Eigen::Isometry3d::Identity());
  for (Key i = 0; i < kPoses; ++i) estimate.keys.push_back(i);
  Trajectory truth = estimate;
  for (std::size_t i = 0; i < kPoses; ++i) truth.poses[i].translation().x() = static_cast<double>(i);
  const PosePairs pairs = associate(estimate, truth);
  REQUIRE(pairs.keys == estimate.keys);
  CHECK(pairs.truth[kPoses - 1].translation().x() == static_cast<double>(kPoses - 1));
}

TEST_CASE("associate: pairs equal those of a greedy choice from all pairs", "[io][trajectory][property]") {
  const unsigned seed = GENERATE(range(1u, 41u));
  CAPTURE(seed);
  Rng rng(seed);
  const auto trajectory = [&](std::size_t count) {
    std::set<std::int64_t> stamps;  // distinct: equal ones may be paired in several ways
    while (stamps.size() < count) stamps.insert(static_cast<std::int64_t>(rng.below(1000000000)));
    Trajectory out;
    out.format = TrajectoryFormat::kTum;
    out.stamps_ns.assign(stamps.begin(), stamps.end());
    rng.shuffle(out.stamps_ns);
    out.poses.assign(count, Eigen::Isometry3d::Identity());
    for (std::size_t i = 0; i < count; ++i) {
      out.poses[i].translation().x() = static_cast<double>(i);
      out.keys.push_back(i);
    }
    return out;
  };
  const Trajectory estimate = trajectory(60), truth = trajectory(80);
  std::vector<std::tuple<std::int64_t, std::size_t, std::size_t>> all;
  for (std::size_t e = 0; e < 60; ++e) {
    for (std::size_t t = 0; t < 80; ++t) {
      const std::int64_t gap = std::abs(estimate.stamps_ns[e] - truth.stamps_ns[t]);
      if (gap <= 20000000) all.emplace_back(gap, e, t);
    }
  }
  std::sort(all.begin(), all.end());
  std::map<std::size_t, std::size_t> expected;
  std::set<std::size_t> used;
  for (const auto& [gap, e, t] : all) {
    if (expected.count(e) == 0 && used.insert(t).second) expected[e] = t;
  }
  const PosePairs pairs = associate(estimate, truth, 0.02);
  REQUIRE(pairs.keys.size() == expected.size());
  for (std::size_t i = 0; i < pairs.keys.size(); ++i) {
    CHECK(pairs.truth[i].translation().x() == static_cast<double>(expected.at(pairs.keys[i])));
  }
}

TEST_CASE("associate: by key, by stamp, by row", "[io][trajectory]") {
  const std::string pose = " 0 0 0 0 0 1\n";
  SECTION("keys") {
    const PosePairs pairs = associate(read("VERTEX_SE3:QUAT 5 1" + pose + "VERTEX_SE3:QUAT 3 2" + pose),
                                      read("VERTEX_SE3:QUAT 3 20" + pose + "VERTEX_SE3:QUAT 4 0" + pose));
    CHECK(pairs.keys == std::vector<Key>{3});
    CHECK(pairs.estimate[0].translation().x() == 2.0);
    CHECK(pairs.truth[0].translation().x() == 20.0);
    CHECK(pairs.problems.count("pose without truth") == 1);
    CHECK(pairs.problems.count("truth without pose") == 1);
  }
  SECTION("stamps, each once, the nearest first") {
    const Trajectory estimate = read("1.00 1" + pose + "1.01 2" + pose + "5 3" + pose);
    const PosePairs pairs = associate(estimate, read("1.012 20" + pose + "1.03 0" + pose + "0.99 10" + pose));
    REQUIRE(pairs.keys == std::vector<Key>{0, 1});
    CHECK(pairs.truth[0].translation().x() == 10.0);
    CHECK(pairs.truth[1].translation().x() == 20.0);
    CHECK(associate(estimate, read("1.012 20" + pose)).keys == std::vector<Key>{1});
    CHECK_THAT(associate(estimate, read("1.012 20" + pose)).problems.all().front().example,
               Contains("stamp 1.000000000"));
    CHECK_THROWS_WITH(
        associate(estimate, read("100 1" + pose)),
        Contains("no stamps close enough, those of the estimate are 1.000000000 to 5.000000000 s, of "
                 "the truth 100.000000000 to 100.000000000 s"));
  }
  SECTION("rows") {
    const Trajectory kitti = read("1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 2 0 1 0 2 0 0 1 3\n");
    const Trajectory g2o = read("VERTEX_SE3:QUAT 1 7" + pose);
    CHECK(associate(kitti, g2o).keys == std::vector<Key>{1});
    CHECK(associate(g2o, kitti).truth[0].translation().x() == 2.0);
    CHECK(associate(kitti, read("1 1" + pose + "2 2" + pose)).keys.size() == 2);
    CHECK_THROWS_WITH(associate(kitti, read("1 1" + pose)),
                      Contains("cannot pair 2 poses (kitti) with 1 (tum)"));
    CHECK_THROWS_AS(associate(kitti, read("VERTEX_SE3:QUAT a1 7" + pose)), InputError);
    CHECK_THROWS_AS(associate(kitti, read("VERTEX_SE3:QUAT 9 7" + pose)), InputError);
  }
}

TEST_CASE("transform: a matrix or a pose", "[io][trajectory]") {
  Eigen::Isometry3d expected = Eigen::Isometry3d::Identity();
  expected.translation() << 1, 2, 3;
  expected.linear() = se3::so3_exp({0, 0, M_PI / 2});
  for (const char* text : {"0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n", "# T\n0 -1 0 1 1 0 0 2 0 0 1 3",
                           "1 2 3 0 0 0.70710678118654757 0.70710678118654757\n"}) {
    CHECK(testing::difference(transform(text), expected) < 1e-15);
  }
  CHECK_THROWS_WITH(transform("1 2 3\n"), Contains("T.txt:1: 3 numbers, expected 12 or 16"));
  CHECK_THROWS_WITH(transform("0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 1 1\n"), Contains("must be 0 0 0 1"));
  CHECK_THROWS_WITH(transform("1 0 0 1 0 1 0 1 0 0 1 1 0 0 0 1 5\n"), Contains("more than 16"));
  CHECK_THROWS_WITH(transform("1 0 0 1 0 1 0 nan 0 0 1 1\n"), Contains("is not finite"));
  CHECK_THROWS_WITH(transform(""), Contains("T.txt:1: 0 numbers"));
}

TEST_CASE("transform: the real one can be read", "[io][trajectory][data]") {
  const auto folder = testing::test_data("kitti_pair");
  if (!folder) return;
  const Eigen::Isometry3d T = read_transform(*folder / "T_target_source.txt");
  CHECK(T.translation().norm() < 5.0);
}

}  // namespace
}  // namespace loopwise::trajectory_test
