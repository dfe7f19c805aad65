// SPDX-License-Identifier: BSD-3-Clause
// Clouds of PCL in, transform out. Loopwise itself needs no PCL for it.
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <cstdio>
#include <stdexcept>

#include <loopwise/io/cloud.hpp>
#include <loopwise/registration/align.hpp>

Eigen::Isometry3d pose_of_source(const pcl::PointCloud<pcl::PointXYZI>& target,
                                 const pcl::PointCloud<pcl::PointXYZI>& source) {
  const loopwise::AlignResult result = loopwise::align(target, source);  // drops NaN points
  if (!result.success) throw std::runtime_error(result.message);
  return result.T_target_source;
}

pcl::PointCloud<pcl::PointXYZI> read(const char* path) {  // or pcl::io::loadPCDFile()
  pcl::PointCloud<pcl::PointXYZI> cloud;
  for (const Eigen::Vector3f& p : loopwise::read_cloud(path).cloud.points) {
    cloud.push_back(pcl::PointXYZI(p.x(), p.y(), p.z(), 0.0F));
  }
  return cloud;
}

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const Eigen::Vector3d position = pose_of_source(read(argv[1]), read(argv[2])).translation();
  std::printf("x y z: %.2f %.2f %.2f m\n", position.x(), position.y(), position.z());
}
