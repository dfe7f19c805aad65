// SPDX-License-Identifier: BSD-3-Clause
// building_blocks TARGET SOURCE: the steps of a registration one by one, on points of a type of your own.
#include <cstdio>
#include <vector>

#include <loopwise/features/kd_tree.hpp>
#include <loopwise/features/normals.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/registration/consensus.hpp>
#include <loopwise/registration/fpfh.hpp>
#include <loopwise/registration/gicp.hpp>
#include <loopwise/registration/matching.hpp>

struct Echo {
  double time;
  float x, y, z;  // m, with the sensor at zero
};

loopwise::PointCloud prepared(const std::vector<Echo>& scan) {
  loopwise::PointCloud cloud = loopwise::voxel_downsample(scan, 0.5);
  cloud.normals = loopwise::estimate_normals(cloud.points, loopwise::KdTree(cloud.points));
  return cloud;
}

/// T_target_source of two scans of one place, without a guess. Call align() for a result that is tested.
Eigen::Isometry3d pose_of_source(const std::vector<Echo>& target_scan, const std::vector<Echo>& source_scan) {
  using namespace loopwise;
  const PointCloud target = prepared(target_scan), source = prepared(source_scan);
  const KdTree target_tree(target), source_tree(source);
  const auto similar = match_descriptors(fpfh(target, target_tree), fpfh(source, source_tree));
  const Consensus poses = consensus(matched_points(target, source, similar));
  if (poses.hypotheses.empty()) throw Error("no three matches agree on a pose");
  return gicp(target, target_tree, source, poses.hypotheses.front().T_target_source).T_target_source;
}

std::vector<Echo> read(const char* path) {
  std::vector<Echo> scan;
  for (const Eigen::Vector3f& p : loopwise::read_cloud(path).cloud.points) {
    scan.push_back({0.0, p.x(), p.y(), p.z()});
  }
  return scan;
}

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const Eigen::Vector3d position = pose_of_source(read(argv[1]), read(argv[2])).translation();
  std::printf("x y z: %.2f %.2f %.2f m\n", position.x(), position.y(), position.z());
}
