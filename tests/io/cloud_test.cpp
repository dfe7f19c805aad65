// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/cloud.hpp>

#include <algorithm>
#include <cstring>
#include <limits>

#include <loopwise/core/error.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::cloud_test {
namespace {

using testing::random_cloud;
using testing::TemporaryFolder;

CloudFile read_as(const std::string& name, const std::string& contents) {
  const TemporaryFolder folder;
  testing::write_text(folder / name, contents);
  return read_cloud(folder / name);
}

std::string floats(const std::vector<float>& values) {
  std::string bytes(values.size() * sizeof(float), '\0');
  std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

std::string pcd_header(const std::string& count, const std::string& data) {
  return "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH " + count +
         "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + count + "\nDATA " + data + "\n";
}

TEST_CASE("cloud: every form gives back the same floats", "[io][cloud]") {
  const std::size_t count = GENERATE(0u, 1u, 5u, 1000u);
  const bool normals = GENERATE(false, true), intensity = GENERATE(false, true);
  CAPTURE(count, normals, intensity);
  const PointCloud cloud = random_cloud(count, normals, intensity);
  const TemporaryFolder folder;
  const auto check = [&](const std::filesystem::path& path) {
    CAPTURE(path.string());
    const CloudFile back = read_cloud(path);
    CHECK(back.problems.empty());
    CHECK(back.cloud.points == cloud.points);
    CHECK(back.cloud.intensities == cloud.intensities);
    REQUIRE(back.cloud.normals.size() == cloud.normals.size());
    for (std::size_t i = 0; i < cloud.normals.size(); ++i) {
      CHECK((back.cloud.normals[i] - cloud.normals[i]).norm() < 1e-6f);  // scaled to unit length once more
    }
  };
  for (const auto& [encoding, word] : enum_names(PcdEncoding{})) {
    const auto path = folder / (std::string(word) + ".pcd");
    write_pcd(path, cloud, encoding);
    check(path);
  }
  write_ply(folder / "a.ply", cloud);
  check(folder / "a.ply");
}

TEST_CASE("cloud: compression shrinks repeated data and keeps other data intact", "[io][cloud]") {
  const TemporaryFolder folder;
  PointCloud cloud;
  cloud.points.assign(10000, Eigen::Vector3f(1, 2, 3));
  write_pcd(folder / "a.pcd", cloud);
  CHECK(std::filesystem::file_size(folder / "a.pcd") < 3000);  // measured: 1.6 kB of 120 kB
  CHECK(read_cloud(folder / "a.pcd").cloud.points == cloud.points);
  for (std::size_t count = 0; count < 60; ++count) {
    cloud = random_cloud(count, false, true);
    if (count % 2 == 1)
      std::fill(cloud.points.begin(), cloud.points.end(), Eigen::Vector3f(0, 0, float(count)));
    write_pcd(folder / "b.pcd", cloud);
    CHECK(read_cloud(folder / "b.pcd").cloud.points == cloud.points);
  }
}

TEST_CASE("cloud: fields in any order, of any type, padded or not", "[io][cloud]") {
  SECTION("ascii") {
    const CloudFile file =
        read_as("a.pcd",
                "VERSION .7\r\nFIELDS rgb z _ x intensity y t\r\nSIZE 4 8 1 4 1 2 8\r\nTYPE U F U F U I U\r\n"
                "COUNT 1 1 3 1 1 1 1\r\nWIDTH 2\r\nHEIGHT 1\r\nPOINTS 2\r\nDATA ascii\r\n"
                "4 3.5 0 0 0 1e0 200 -2 99\r\n\r\n4 6.5 0 0 0 +4 7 5 99 \r\n");
    REQUIRE(file.cloud.size() == 2);
    CHECK(file.cloud.points[0] == Eigen::Vector3f(1.0f, -2.0f, 3.5f));
    CHECK(file.cloud.points[1] == Eigen::Vector3f(4.0f, 5.0f, 6.5f));
    CHECK(file.cloud.intensities == std::vector<float>{200.0f, 7.0f});
    CHECK_FALSE(file.cloud.has_normals());
  }
  SECTION("binary, 32 bytes a point as PCL pads it") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const CloudFile file = read_as(
        "a.pcd",
        "FIELDS x y z _ intensity _\nSIZE 4 4 4 1 4 1\nTYPE F F F U F U\nCOUNT 1 1 1 4 1 12\nWIDTH 1\nHEIGHT "
        "2\nPOINTS 2\nDATA binary\n" +
            floats({1, 2, 3, nan, 9, nan, nan, nan, 4, 5, 6, nan, 8, nan, nan, nan}));
    REQUIRE(file.cloud.size() == 2);
    CHECK(file.cloud.points[1] == Eigen::Vector3f(4, 5, 6));
    CHECK(file.cloud.intensities == std::vector<float>{9, 8});
  }
  SECTION("big-endian PLY with doubles and faces behind") {
    std::string data;
    for (const double value : {1.5, -2.0, 3.0}) {
      std::string bytes(8, '\0');
      std::memcpy(bytes.data(), &value, 8);
      std::reverse(bytes.begin(), bytes.end());
      data += bytes;
    }
    const CloudFile file =
        read_as("a.ply",
                "ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty double x\nproperty "
                "double y\nproperty double z\nelement face 1\nproperty list uchar int v\nend_header\n" +
                    data + std::string("\0", 1));
    REQUIRE(file.cloud.size() == 1);
    CHECK(file.cloud.points[0] == Eigen::Vector3f(1.5f, -2.0f, 3.0f));
  }
  SECTION("ascii PLY") {
    const CloudFile file =
        read_as("a.ply",
                "ply\nformat ascii 1.0\ncomment x\nelement vertex 2\nproperty float x\nproperty float "
                "y\nproperty float z\nproperty uchar intensity\nend_header\n1 2 3 4\n5 6 7 8\n");
    CHECK(file.cloud.size() == 2);
    CHECK(file.cloud.intensities == std::vector<float>{4, 8});
  }
  SECTION("KITTI") {
    const CloudFile file = read_as("a.bin", floats({1, 2, 3, 0.5f, 4, 5, 6, 0.25f}));
    REQUIRE(file.cloud.size() == 2);
    CHECK(file.cloud.points[1] == Eigen::Vector3f(4, 5, 6));
    CHECK(file.cloud.intensities == std::vector<float>{0.5f, 0.25f});
  }
}

TEST_CASE("cloud: points that cannot be used are dropped and counted", "[io][cloud]") {
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  const CloudFile binary =
      read_as("a.bin", floats({1, 2, 3, 0, nan, 2, 3, 0, 1, inf, 3, 0, 1e30f, 0, 0, 0, 4, 5, 6, nan}));
  CHECK(binary.cloud.size() == 2);
  CHECK(binary.problems.count("point not finite") == 2);
  CHECK(binary.problems.count("point out of range") == 1);
  CHECK(binary.problems.count("intensity not finite") == 1);
  CHECK_THAT(binary.problems.all()[0].example, Contains("a.bin: point 1"));
  CHECK(binary.cloud.intensities == std::vector<float>{0, 0});

  const CloudFile ascii = read_as("a.pcd", pcd_header("3", "ascii") + "nan nan nan\n1 2 3\n1 -inf 1e60\n");
  CHECK(ascii.cloud.points == std::vector<Eigen::Vector3f>{{1, 2, 3}});
  CHECK(ascii.problems.count("point not finite") == 2);

  CHECK(read_as("a.bin", "").problems.count("empty file") == 1);
}

TEST_CASE("cloud: normals are taken whole or not at all, and face the sensor", "[io][cloud]") {
  const std::string header =
      "FIELDS x y z normal_x normal_y normal_z\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\nWIDTH 2\nHEIGHT "
      "1\nPOINTS 2\nDATA "
      "ascii\n";
  const CloudFile good = read_as("a.pcd", header + "1 0 0 1 0 0\n0 2 0 0 -1.001 0\n");
  REQUIRE(good.cloud.has_normals());
  CHECK(good.cloud.normals[0] == Eigen::Vector3f(-1, 0, 0));
  CHECK(good.cloud.normals[1] == Eigen::Vector3f(0, -1, 0));
  const std::string bad = GENERATE("0 0 0", "nan nan nan", "3 0 0");
  const CloudFile zero = read_as("a.pcd", header + "1 0 0 1 0 0\n0 2 0 " + bad + "\n");
  CHECK(zero.cloud.size() == 2);
  CHECK(zero.cloud.normals.empty());
  CHECK(zero.problems.count("unusable normals") == 1);
}

TEST_CASE("cloud: false headers are refused before memory is allocated", "[io][cloud][error]") {
  struct Bad {
    std::string name;
    std::string contents;
    std::string message;
  };
  const std::string ply = "ply\nformat binary_little_endian 1.0\nelement vertex ";
  const std::string xyz = "\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
  const std::string one = floats({1, 2, 3});
  const Bad bad = GENERATE_COPY(values<Bad>({
      {"a.pcd", "", "no DATA line"},
      {"a.pcd", "VERSION 0.7\nFIELDS x y z\n", "no DATA line"},
      {"a.pcd", pcd_header("16000000000", "binary") + one,
       "16000000000 points need 192000000000 bytes, found 12"},
      {"a.pcd", pcd_header("16000000000", "ascii") + "1 2 3\n", "16000000000 points need"},
      {"a.pcd", pcd_header("16000000000", "binary_compressed") + one, "bytes of data for 16000000000 points"},
      {"a.pcd", pcd_header("18446744073709551615", "binary") + one, "is more than a file can hold"},
      {"a.pcd", pcd_header("18446744073709551616", "binary") + one, "exceeds 64 bits"},
      {"a.pcd", pcd_header("-1", "binary") + one, "is negative"},
      {"a.pcd", pcd_header("2", "binary") + one, "2 points need 24 bytes, found 12"},
      {"a.pcd", pcd_header("2", "ascii") + "1 2 3\n", "2 points"},
      {"a.pcd", pcd_header("1", "ascii") + "1 2 3\n4 5 6\n", "a.pcd:13: more points than the header's 1"},
      {"a.pcd", pcd_header("1", "ascii") + "1 2\n\n\n\n", "a.pcd:12: a point needs 3 values, found 2"},
      {"a.pcd", pcd_header("1", "ascii") + "1 2 x3\n", "a.pcd:12: \"x3\" is not a number"},
      {"a.pcd", pcd_header("1", "zip") + one, "must be one of: ascii, binary, binary_compressed"},
      {"a.pcd",
       pcd_header("1", "binary_compressed") + std::string("\x05\0\0\0\x0c\0\0\0\xff\xff\xff\xff\xff", 13),
       "compressed data are damaged"},
      {"a.pcd",
       pcd_header("1000", "binary_compressed") +
           std::string("\x05\0\0\0\xe0\x2e\0\0\xff\xff\xff\xff\xff", 13),
       "cut short"},
      {"a.pcd",
       "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 4294967296\nHEIGHT 4294967296\nPOINTS 0\nDATA binary\n",
       "do not multiply to POINTS 0"},
      {"a.pcd", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 2\nPOINTS 5\nDATA binary\n",
       "WIDTH 2 and HEIGHT 2 do not multiply to POINTS 5"},
      {"a.pcd", "FIELDS x y z\nWIDE 1\n", "a.pcd:2: unknown keyword \"WIDE\" in the PCD header"},
      {"a.pcd", "FIELDS x y z\nSIZE 4 4\nTYPE F F F\nWIDTH 1\nPOINTS 1\nDATA binary\n" + one,
       "as many values, found 3, 2"},
      {"a.pcd", "FIELDS x y\nSIZE 4 4\nTYPE F F\nWIDTH 1\nPOINTS 1\nDATA binary\n" + one, "no x, y and z"},
      {"a.pcd", "FIELDS x y z\nSIZE 3 4 4\nTYPE F F F\nWIDTH 1\nPOINTS 1\nDATA binary\n" + one,
       "unsupported TYPE \"F\" with SIZE 3"},
      {"a.pcd", "\x89PNG\r\n", "is an image, expected a PCD cloud"},
      {"a.ply", "", "is not a PLY file"},
      {"a.ply", "ply\nformat ascii 1.0\n", "no end_header"},
      {"a.ply", "ply\nformat text 1.0\n", "a.ply:2: unknown PLY format \"text\""},
      {"a.ply", "ply\nvertices 5\n", "a.ply:2: unknown keyword \"vertices\" in the PLY header"},
      {"a.ply", ply + "16000000000" + xyz + one, "16000000000 points"},
      {"a.ply", ply + "2" + xyz + one, "cut short"},
      {"a.ply", "ply\nformat binary_little_endian 1.0\nelement point 1" + xyz, "no element vertex"},
      {"a.ply", "ply\nelement vertex 1" + xyz, "no format line"},
      {"a.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float32 x\nproperty half y\nend_header\n",
       "unknown PLY type \"half\""},
      {"a.bin", one, "not a multiple of the point size"},
      {"a.xyz", "1 2 3\n", "expected .pcd, .ply or .bin"},
  }));
  CAPTURE(bad.contents);
  CHECK_THROWS_AS(read_as(bad.name, bad.contents), InputError);
  CHECK_THROWS_WITH(read_as(bad.name, bad.contents), Contains(bad.message) && Contains(bad.name));
}

TEST_CASE("cloud: cutting or damaging a file anywhere never crashes", "[io][cloud][property]") {
  const TemporaryFolder folder;
  const PointCloud cloud = random_cloud(40, true, true);
  for (const std::string name : {"ascii.pcd", "binary.pcd", "binary_compressed.pcd", "a.ply"}) {
    const auto path = folder / name;
    if (name == "a.ply") {
      write_ply(path, cloud);
    } else {
      write_pcd(path, cloud, parse_enum<PcdEncoding>("encoding", name.substr(0, name.size() - 4)));
    }
    const std::string whole = testing::read_text(path);
    std::size_t accepted = 0;
    for (std::size_t length = 0; length + 1 < whole.size(); length += 3) {
      try {
        const CloudFile file = read_as(name, whole.substr(0, length));
        ++accepted;
        CAPTURE(name, length, whole.size());
        CHECK_FALSE(file.problems.empty());
      } catch (const InputError&) {
        continue;
      }
    }
    CHECK(accepted <= 4);  // of ascii data the last digits alone
    Rng rng(1);
    for (int i = 0; i < 300; ++i) {
      std::string damaged = whole;
      for (int k = 0; k < 3; ++k) damaged[rng.below(damaged.size())] = static_cast<char>(rng.below(256));
      try {
        const CloudFile file = read_as(name, damaged);
        for (const auto& point : file.cloud.points) REQUIRE(point.allFinite());
      } catch (const InputError&) {
        continue;
      }
    }
  }
}

TEST_CASE("cloud: the real scans can be read", "[io][cloud][data]") {
  const auto folder = testing::test_data("kitti_pair");
  if (!folder) return;
  for (const char* name : {"source.ply", "target.ply"}) {
    const CloudFile file = read_cloud(*folder / name);
    CHECK(file.cloud.size() > 100);
    CHECK(file.problems.count("point not finite") == 0);
  }
}

}  // namespace
}  // namespace loopwise::cloud_test
