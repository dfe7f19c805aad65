// SPDX-License-Identifier: BSD-3-Clause
// align_pcl TARGET SOURCE: clouds of PCL in, transform out. Loopwise itself needs no PCL for it.
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <cstdio>
#include <stdexcept>

#include <loopwise/features/normals.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/registration/align.hpp>
#include <loopwise/registration/gicp.hpp>

using Cloud = pcl::PointCloud<pcl::PointXYZI>;

Eigen::Isometry3d pose_of_source(const Cloud& target, const Cloud& source) {
  const loopwise::AlignResult result = loopwise::align(target, source);  // drops NaN points
  if (!result.success) throw std::runtime_error(result.message);
  return result.T_target_source;
}

/// From a guess, by generalized ICP alone. The clouds are read where they are.
Eigen::Isometry3d refined(const Cloud& target, const Cloud& source, const Eigen::Isometry3d& guess) {
  const loopwise::KdTree target_tree(target), source_tree(source);
  const auto target_normals = loopwise::estimate_normals(target, target_tree);
  const auto source_normals = loopwise::estimate_normals(source, source_tree);
  const auto result = loopwise::gicp({target, target_normals}, target_tree, {source, source_normals}, guess);
  if (!result.converged) throw std::runtime_error("the guess is too far away");
  return result.T_target_source;
}

Cloud read(const char* path) {  // or pcl::io::loadPCDFile()
  Cloud cloud;
  for (const Eigen::Vector3f& p : loopwise::read_cloud(path).cloud.points) {
    cloud.push_back(pcl::PointXYZI(p.x(), p.y(), p.z(), 0.0F));
  }
  return cloud;
}

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const Cloud target = read(argv[1]), source = read(argv[2]);
  const Eigen::Isometry3d T_target_source = pose_of_source(target, source);
  const Eigen::Isometry3d again = refined(target, source, T_target_source);
  const Eigen::Vector3d position = T_target_source.translation();
  std::printf("x y z: %.2f %.2f %.2f m\n", position.x(), position.y(), position.z());
  return (again.translation() - position).norm() < 0.2 ? 0 : 1;
}
