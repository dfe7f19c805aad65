// SPDX-License-Identifier: BSD-3-Clause
// Files without a header: a file with another layout than assumed must not pass as points.
#include <cmath>
#include <cstring>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>

#include "testing.hpp"

namespace loopwise::bin_layout_test {
namespace {

using testing::TemporaryFolder;

template <class T>
void put(std::string& out, double value) {
  const auto number = static_cast<T>(value);
  char bytes[sizeof(T)];
  std::memcpy(bytes, &number, sizeof(T));
  out.append(bytes, sizeof(T));
}

template <class T>
void put_all(std::string& out, std::initializer_list<double> values) {
  for (const double value : values) put<T>(out, value);
}

/// Two turns of 16 beams in a room, point by point as a spinning lidar has them.
struct Sweep {
  static constexpr int kPoints = 3200;

  static Eigen::Vector3d point(int i) {
    const double azimuth = 2.0 * 3.14159265358979 * (i / 16) / 200.0, elevation = (i % 16 - 7.5) * 0.035;
    const double range = 6.0 + 2.0 * std::sin(3.0 * azimuth);
    return range * Eigen::Vector3d(std::cos(azimuth) * std::cos(elevation),
                                   std::sin(azimuth) * std::cos(elevation), std::sin(elevation));
  }

  static std::string bytes(BinLayout layout, int points = kPoints) {
    std::string out;
    for (int i = 0; i < points; ++i) {
      const Eigen::Vector3d p = point(i);
      const double bright = i % 97, ring = i % 16, time_s = 1e-5 * i, time_ns = 1e4 * i;
      const auto xyz = [&] { put_all<float>(out, {p.x(), p.y(), p.z()}); };
      switch (layout) {
        case BinLayout::kXyz:
          xyz();
          break;
        case BinLayout::kAuto:
        case BinLayout::kXyzi:
          xyz();
          put<float>(out, bright);
          break;
        case BinLayout::kXyzir:
          xyz();
          put_all<float>(out, {bright, ring});
          break;
        case BinLayout::kXyzirt:
          xyz();
          put_all<float>(out, {bright, ring, time_s});
          break;
        case BinLayout::kXyzDouble:
          put_all<double>(out, {p.x(), p.y(), p.z()});
          break;
        case BinLayout::kXyziDouble:
          put_all<double>(out, {p.x(), p.y(), p.z(), bright});
          break;
        case BinLayout::kHeliprOuster:
          xyz();
          put<float>(out, bright);
          put<std::uint32_t>(out, time_ns);
          put_all<std::uint16_t>(out, {bright, ring, 7});
          break;
        case BinLayout::kHeliprVelodyne:
          xyz();
          put<float>(out, bright);
          put<std::uint16_t>(out, ring);
          put<float>(out, time_s);
          break;
        case BinLayout::kHeliprAvia:
          xyz();
          put_all<std::uint8_t>(out, {bright, 16, ring});
          put<std::uint32_t>(out, time_ns);
          break;
        case BinLayout::kHeliprAeva:
        case BinLayout::kHeliprAevaIntensity:
          xyz();
          put_all<float>(out, {bright, -0.5});
          put<std::int32_t>(out, time_ns);
          put<std::uint8_t>(out, ring);
          if (layout == BinLayout::kHeliprAevaIntensity) put<float>(out, bright);
          break;
      }
    }
    return out;
  }
};

void check_points(const PointCloud& cloud) {
  REQUIRE(cloud.size() == Sweep::kPoints);
  for (int i = 0; i < Sweep::kPoints; i += 7) {
    REQUIRE((cloud.points[static_cast<std::size_t>(i)].cast<double>() - Sweep::point(i)).norm() < 1e-5);
  }
}

}  // namespace

TEST_CASE("bin layout: each is read when it is named, and named when it is not", "[io][cloud]") {
  const TemporaryFolder folder;
  for (const auto& [layout, word] : enum_names(BinLayout::kAuto)) {
    if (layout == BinLayout::kAuto) continue;
    CAPTURE(word);
    const auto file = folder / "scan.bin";
    testing::write_text(file, Sweep::bytes(layout));
    const CloudFile named = read_cloud(file, layout);
    CHECK(named.problems.empty());
    check_points(named.cloud);
    if (layout == BinLayout::kXyzi) {
      check_points(read_cloud(file).cloud);
      continue;
    }
    CHECK_THROWS_AS(read_cloud(file), InputError);
    CHECK_THROWS_WITH(read_cloud(file),
                      Contains("scan.bin: ") && Contains("--bin-layout " + std::string(word)));
  }
}

TEST_CASE("bin layout: a wrong one is detected at any number of points", "[io][cloud]") {
  const TemporaryFolder folder;
  // Misread as xyzi, these are a whole multiple of 2000 points, which a regular stride meets at one field.
  const auto [layout, points] = GENERATE(table<BinLayout, int>({{BinLayout::kXyz, 24000},
                                                                {BinLayout::kXyzir, 32000},
                                                                {BinLayout::kXyzir, 64000},
                                                                {BinLayout::kXyzirt, 32000},
                                                                {BinLayout::kXyzDouble, 16000}}));
  CAPTURE(enum_name(layout), points);
  testing::write_text(folder / "a.bin", Sweep::bytes(layout, points));
  CHECK_THROWS_WITH(read_cloud(folder / "a.bin"), Contains("--bin-layout " + enum_name(layout)));
}

TEST_CASE("bin layout: a level beam with a rounded sine does not indicate another layout", "[io][cloud]") {
  const TemporaryFolder folder;
  std::string text;
  for (int i = 0; i < 400; ++i) {
    const double azimuth = 2.0 * 3.14159265358979 * i / 400.0, range = 6.0 + 2.0 * std::sin(3.0 * azimuth);
    put_all<float>(text,
                   {range * std::cos(azimuth), range * std::sin(azimuth), range * 6e-17, 0.5 * (i % 9)});
  }
  testing::write_text(folder / "a.bin", text);
  CHECK(read_cloud(folder / "a.bin").cloud.size() == 400);
}

TEST_CASE("bin layout: a wrong one that is named is read and reported", "[io][cloud]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "a.bin", Sweep::bytes(BinLayout::kXyzir));
  const CloudFile wrong = read_cloud(folder / "a.bin", BinLayout::kXyzi);
  CHECK(wrong.problems.count("points that do not fit the layout") == 1);
  CHECK_THROWS_WITH(read_cloud(folder / "a.bin", BinLayout::kHeliprOuster),
                    Contains("point size of 26 bytes (helipr_ouster)"));
}

TEST_CASE("bin layout: a file that fits no layout is refused with the remedies", "[io][cloud][error]") {
  const TemporaryFolder folder;
  std::string noise;
  Rng rng(5);
  for (int i = 0; i < 16000; ++i) noise += static_cast<char>(rng.below(256));
  testing::write_text(folder / "a.bin", noise);
  CHECK_THROWS_WITH(read_cloud(folder / "a.bin"), Contains("another layout") && Contains("--bin-layout"));
  testing::write_text(folder / "b.bin", Sweep::bytes(BinLayout::kXyzi) + "x");
  CHECK_THROWS_WITH(read_cloud(folder / "b.bin"), Contains("not a multiple of the point size"));
}

TEST_CASE("bin layout: an option of missions", "[io][mission]") {
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder / "Scans");
  testing::write_text(folder / "odom_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
  for (const char* name : {"000000.bin", "000001.bin"}) {
    testing::write_text(folder / "Scans" / name, Sweep::bytes(BinLayout::kXyzir));
  }
  const Mission guessed = read_mission(folder.path());
  CHECK_THROWS_WITH(guessed.scans->load(0), Contains("000000.bin") && Contains("mission.bin_layout"));
  MissionOptions options;
  options.bin_layout = BinLayout::kXyzir;
  const Mission named = read_mission(folder.path(), options);
  check_points(*named.scans->load(1));
}

TEST_CASE("bin layout: recorded files", "[io][cloud][data]") {
  const auto folder = testing::test_data("../cases/clouds");
  if (!folder) return;
  CHECK_THROWS_WITH(read_cloud(*folder / "a_nuscenes.pcd.bin"), Contains("looks like xyzir"));
  CHECK_THROWS_WITH(read_cloud(*folder / "a_helipr.bin"), Contains("looks like helipr_ouster"));
  const PointCloud kitti = read_cloud(*folder / "a_kitti.bin").cloud;
  CHECK(read_cloud(*folder / "a_nuscenes.pcd.bin", BinLayout::kXyzir).cloud.points == kitti.points);
  CHECK(read_cloud(*folder / "a_helipr.bin", BinLayout::kHeliprOuster).cloud.points == kitti.points);
}

}  // namespace loopwise::bin_layout_test
