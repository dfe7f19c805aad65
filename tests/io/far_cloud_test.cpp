// SPDX-License-Identifier: BSD-3-Clause
// Clouds in world coordinates: reading loses no digits, and digits already lost in floats are reported.
#include <cstring>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/scan_store.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::far_cloud_test {
namespace {

using testing::random_cloud;
using testing::TemporaryFolder;

const Eigen::Vector3d kFar(432100.25, 5432109.75, 87.5);
constexpr const char* kCoarse = "point rounded to a float far from zero";

/// Points about `offset` as a PCD file of numbers of type T.
template <class T>
std::string pcd_of(const PointCloud& cloud, const Eigen::Vector3d& offset, const std::string& size) {
  const std::string count = std::to_string(cloud.size());
  std::string out = "VERSION 0.7\nFIELDS x y z\nSIZE " + size + " " + size + " " + size +
                    "\nTYPE F F F\nCOUNT 1 1 1\nWIDTH " + count + "\nHEIGHT 1\nPOINTS " + count +
                    "\nDATA binary\n";
  for (const Eigen::Vector3f& p : cloud.points) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      const auto value = static_cast<T>(static_cast<double>(p[axis]) + offset[axis]);
      char bytes[sizeof(T)];
      std::memcpy(bytes, &value, sizeof(T));
      out.append(bytes, sizeof(T));
    }
  }
  return out;
}

CloudFile read_text_as(const std::string& name, const std::string& contents) {
  const TemporaryFolder folder;
  testing::write_text(folder / name, contents);
  return read_cloud(folder / name);
}

double largest_error_m(const PointCloud& read, const PointCloud& truth, const Eigen::Vector3d& offset) {
  double largest = 0.0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const Eigen::Vector3d there = read.origin + read.points[i].cast<double>();
    largest = std::max(largest, (there - offset - truth.points[i].cast<double>()).norm());
  }
  return largest;
}

}  // namespace

TEST_CASE("far cloud: doubles keep their digits", "[io][cloud]") {
  const PointCloud cloud = random_cloud(500, false, false);
  const CloudFile far = read_text_as("a.pcd", pcd_of<double>(cloud, kFar, "8"));
  CHECK(far.problems.empty());
  REQUIRE(far.cloud.size() == 500);
  CHECK((far.cloud.origin - kFar).norm() < 10.0);
  CHECK(far.cloud.origin == Eigen::Vector3d(far.cloud.origin.array().round()));
  CHECK(largest_error_m(far.cloud, cloud, kFar) < 1e-5);  // measured 4e-6 m; floats would cost 0.25 m

  const CloudFile near = read_text_as("a.pcd", pcd_of<double>(cloud, Eigen::Vector3d::Zero(), "8"));
  CHECK(near.cloud.origin.isZero(0.0));
  CHECK(near.cloud.points == cloud.points);
}

TEST_CASE("far cloud: text keeps its digits too", "[io][cloud]") {
  const CloudFile file = read_text_as("a.ply",
                                      "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty "
                                      "double y\nproperty double z\nend_header\n"
                                      "432100.123 5432109.456 7.5\n432101.124 5432109.456 7.5\n");
  REQUIRE(file.cloud.size() == 2);
  const Eigen::Vector3f step = file.cloud.points[1] - file.cloud.points[0];
  CHECK(std::abs(step.x() - 1.001F) < 1e-5F);
  CHECK(file.problems.empty());
}

TEST_CASE("far cloud: floats that lost their digits are counted", "[io][cloud]") {
  const PointCloud cloud = random_cloud(500, false, false);
  const CloudFile far = read_text_as("a.pcd", pcd_of<float>(cloud, kFar, "4"));
  CHECK(far.problems.count(kCoarse) == 500);
  CHECK_THAT(far.problems.all()[0].example, Contains("a.pcd: point 0, in steps of 0.5 m"));
  // The same values in doubles were rounded as well.
  PointCloud rounded = cloud;
  for (Eigen::Vector3f& p : rounded.points) {
    p = ((p.cast<double>() + kFar).cast<float>().cast<double>() - kFar).cast<float>();
  }
  CHECK(largest_error_m(far.cloud, rounded, kFar) < 1e-5);
  CHECK(read_text_as("a.pcd", pcd_of<float>(cloud, Eigen::Vector3d(1000, 2000, 0), "4")).problems.empty());
}

TEST_CASE("far cloud: a few strays move neither the middle nor the origin", "[io][cloud]") {
  PointCloud cloud = random_cloud(500, false, false);
  for (int i = 0; i < 60; ++i) cloud.points.emplace_back(1e6F, -9e6F, 1e5F);
  const CloudFile file = read_text_as("a.pcd", pcd_of<float>(cloud, Eigen::Vector3d::Zero(), "4"));
  CHECK(file.cloud.origin.isZero(0.0));
  CHECK(file.cloud.points == cloud.points);
  CHECK(file.problems.empty());
  CHECK(robust_centre(cloud.points).norm() < 10.0);

  cloud.points.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0F, 0.0F);
  CHECK(robust_centre(cloud.points).norm() < 10.0);
  CHECK(robust_centre(std::vector<Eigen::Vector3f>{cloud.points.back()}).isZero(0.0));
}

TEST_CASE("far cloud: an origin is written and read back", "[io][cloud]") {
  PointCloud cloud = random_cloud(100, true, true);
  cloud.origin = {386341.0, 5819822.0, -34.0};
  const TemporaryFolder folder;
  const auto check = [&](const std::filesystem::path& path) {
    CAPTURE(path.string());
    CHECK_THAT(testing::read_text(path), Contains("loopwise origin 386341 5819822 -34\n"));
    const CloudFile back = read_cloud(path);
    CHECK(back.problems.empty());
    CHECK(back.cloud.origin == cloud.origin);
    CHECK(back.cloud.points == cloud.points);
  };
  for (const auto encoding : {PcdEncoding::kAscii, PcdEncoding::kBinary, PcdEncoding::kBinaryCompressed}) {
    write_pcd(folder / "a.pcd", cloud, encoding);
    check(folder / "a.pcd");
  }
  write_ply(folder / "a.ply", cloud);
  check(folder / "a.ply");
  cloud.origin.setZero();
  write_pcd(folder / "b.pcd", cloud);
  CHECK(testing::read_text(folder / "b.pcd").find("origin") == std::string::npos);

  for (const std::string bad : {"1 2", "1 2 x", "1 2 nan", "1 2 1e300"}) {
    CAPTURE(bad);
    testing::write_text(folder / "c.pcd",
                        "# loopwise origin " + bad + "\n" + testing::read_text(folder / "b.pcd"));
    CHECK_THROWS_WITH(read_cloud(folder / "c.pcd"), Contains("c.pcd:1: "));
  }
}

TEST_CASE("far cloud: normals face the middle of the cloud", "[io][cloud]") {
  const std::string header =
      "FIELDS x y z normal_x normal_y normal_z\nSIZE 8 8 8 8 8 8\nTYPE F F F F F F\nWIDTH 3\nHEIGHT "
      "1\nPOINTS 3\nDATA ascii\n";
  const CloudFile file =
      read_text_as("a.pcd", header + "500000 0 0 0 0 1\n499990 0 0 -1 0 0\n500010 0 0 -1 0 0\n");
  REQUIRE(file.cloud.has_normals());
  CHECK(file.cloud.normals[1] == Eigen::Vector3f(1, 0, 0));
  CHECK(file.cloud.normals[2] == Eigen::Vector3f(-1, 0, 0));
}

TEST_CASE("far cloud: a scan of a node must lie about its sensor", "[io][scans][error]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "1.pcd", pcd_of<double>(random_cloud(50, false, false), kFar, "8"));
  const ScanStore store({{1, folder / "1.pcd"}});
  for (int i = 0; i < 2; ++i) {
    CHECK_THROWS_WITH(store.load(1), Contains("1.pcd") && Contains("not in world coordinates"));
  }
  CHECK(store.problems().count("scan is damaged") == 1);
}

TEST_CASE("far cloud: real coordinates of a survey", "[io][cloud][data]") {
  const auto folder = testing::test_data("../cases/clouds");
  if (!folder) return;
  for (const std::string name : {"aw", "bw"}) {
    const CloudFile far = read_cloud(*folder / (name + "_utm.pcd")),
                    near = read_cloud(*folder / (name + "_loc.pcd"));
    REQUIRE(far.cloud.size() == near.cloud.size());
    CHECK(near.cloud.origin.isZero(0.0));
    CHECK(far.problems.empty());
    const Eigen::Vector3d offset =
        far.cloud.origin + (far.cloud.points[0] - near.cloud.points[0]).cast<double>();
    CHECK(largest_error_m(far.cloud, near.cloud, offset) < 1e-5);
  }
}

}  // namespace loopwise::far_cloud_test
