// SPDX-License-Identifier: BSD-3-Clause
// align_clouds TARGET SOURCE: the pose of one scan in the frame of another.
#include <cstdio>

#include <loopwise/io/cloud.hpp>
#include <loopwise/registration/align.hpp>

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const loopwise::PointCloud target = loopwise::read_cloud(argv[1]).cloud;
  const loopwise::PointCloud source = loopwise::read_cloud(argv[2]).cloud;
  const loopwise::AlignResult result = loopwise::align(target, source);
  if (!result.success) {
    std::printf("not aligned: %s\n", result.message.c_str());
    return 1;
  }
  // p_target = T_target_source · p_source. The covariance is over [x y z rx ry rz] in the frame of the
  // source.
  const Eigen::Vector3d position = result.T_target_source.translation();
  const Eigen::Vector3d sigma = result.covariance.diagonal().head<3>().cwiseSqrt();
  std::printf("x y z: %.2f %.2f %.2f m, sigma: %.2f %.2f %.2f m, %.0f %% of the points match\n", position.x(),
              position.y(), position.z(), sigma.x(), sigma.y(), sigma.z(), 100.0 * result.inlier_share);
}
