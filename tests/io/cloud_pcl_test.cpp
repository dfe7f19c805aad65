// SPDX-License-Identifier: BSD-3-Clause
// PCL's readers and writers against ours: each reads what the other wrote.
#include <loopwise/io/cloud.hpp>

#include <pcl/console/print.h>
#include <pcl/io/pcd_io.h>
#include <pcl/io/ply_io.h>
#include <pcl/point_types.h>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::cloud_pcl_test {
namespace {

using testing::random_cloud;
using testing::TemporaryFolder;
using PclCloud = pcl::PointCloud<pcl::PointXYZINormal>;

PclCloud to_pcl(const PointCloud& cloud) {
  PclCloud out;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    pcl::PointXYZINormal point;
    point.getVector3fMap() = cloud.points[i];
    point.getNormalVector3fMap() = cloud.normals[i];
    point.intensity = cloud.intensities[i];
    out.push_back(point);
  }
  return out;
}

void check_equal(const PointCloud& a, const PclCloud& b, float tolerance) {
  REQUIRE(a.size() == b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    CHECK((a.points[i] - b[i].getVector3fMap()).cwiseAbs().maxCoeff() <= tolerance);
    CHECK((a.normals[i] - b[i].getNormalVector3fMap()).cwiseAbs().maxCoeff() <= 1e-6f + tolerance);
    CHECK(std::abs(a.intensities[i] - b[i].intensity) <= tolerance);
  }
}

TEST_CASE("cloud: PCL reads what we write", "[io][cloud][pcl]") {
  pcl::console::setVerbosityLevel(pcl::console::L_ALWAYS);
  const std::size_t count = GENERATE(1u, 5u, 3000u);
  const PointCloud cloud = random_cloud(count, true, true);
  const TemporaryFolder folder;
  for (const auto& [encoding, word] : enum_names(PcdEncoding{})) {
    CAPTURE(word, count);
    write_pcd(folder / "a.pcd", cloud, encoding);
    PclCloud back;
    REQUIRE(pcl::io::loadPCDFile((folder / "a.pcd").string(), back) == 0);
    check_equal(cloud, back, 0.0f);
  }
  write_ply(folder / "a.ply", cloud);
  PclCloud back;
  REQUIRE(pcl::io::loadPLYFile((folder / "a.ply").string(), back) == 0);
  REQUIRE(back.size() == cloud.size());
  for (std::size_t i = 0; i < count; ++i) CHECK(cloud.points[i] == back[i].getVector3fMap());
}

TEST_CASE("cloud: we read what PCL writes", "[io][cloud][pcl]") {
  pcl::console::setVerbosityLevel(pcl::console::L_ALWAYS);
  const std::size_t count = GENERATE(1u, 5u, 3000u);
  const PointCloud cloud = random_cloud(count, true, true);
  const PclCloud written = to_pcl(cloud);
  const TemporaryFolder folder;
  REQUIRE(pcl::io::savePCDFileBinary((folder / "binary.pcd").string(), written) == 0);
  REQUIRE(pcl::io::savePCDFileBinaryCompressed((folder / "compressed.pcd").string(), written) == 0);
  REQUIRE(pcl::io::savePCDFileASCII((folder / "ascii.pcd").string(), written) == 0);
  REQUIRE(pcl::io::savePLYFileBinary((folder / "binary.ply").string(), written) == 0);
  REQUIRE(pcl::io::savePLYFileASCII((folder / "ascii.ply").string(), written) == 0);
  for (const char* name : {"binary.pcd", "compressed.pcd", "ascii.pcd", "binary.ply", "ascii.ply"}) {
    CAPTURE(name, count);
    const CloudFile file = read_cloud(folder / name);
    CHECK(file.problems.empty());
    // PCL prints ascii with eight digits or fewer: measured 1e-5 on intensities of up to 255.
    const bool ascii = std::string(name).find("ascii") == 0;
    check_equal(file.cloud, written, ascii ? 1e-3f : 0.0f);
  }
}

}  // namespace
}  // namespace loopwise::cloud_pcl_test
