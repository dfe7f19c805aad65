// SPDX-License-Identifier: BSD-3-Clause
#include "registration_small_gicp.hpp"

#ifdef LOOPWISE_HAS_SMALL_GICP
#include <tuple>

#include <small_gicp/registration/registration_helper.hpp>

#include "registration_pcl.hpp"
#endif

namespace loopwise::bench {

#ifdef LOOPWISE_HAS_SMALL_GICP

struct SmallGicpScan::Impl {
  small_gicp::PointCloud::Ptr cloud;
  std::shared_ptr<small_gicp::KdTree<small_gicp::PointCloud>> tree;
  small_gicp::GaussianVoxelMap::Ptr voxels;
};

bool has_small_gicp() {
  return true;
}

SmallGicpScan::SmallGicpScan(const PointCloud& cloud, double voxel_m) : impl(std::make_unique<Impl>()) {
  std::tie(impl->cloud, impl->tree) = small_gicp::preprocess_points(cloud.points, voxel_m, 10, 1);
  impl->voxels = small_gicp::create_gaussian_voxelmap(*impl->cloud, 1.0);
}

SmallGicpAlignment small_gicp_align(const SmallGicpScan& source, const SmallGicpScan& target,
                                    const Eigen::Isometry3d& start, bool voxels) {
  small_gicp::RegistrationSetting setting;
  setting.type = voxels ? small_gicp::RegistrationSetting::VGICP : small_gicp::RegistrationSetting::GICP;
  setting.num_threads = 1;
  const double begin = thread_seconds();
  const small_gicp::RegistrationResult result =
      voxels
          ? small_gicp::align(*target.impl->voxels, *source.impl->cloud, start, setting)
          : small_gicp::align(*target.impl->cloud, *source.impl->cloud, *target.impl->tree, start, setting);
  return {result.T_target_source, 1e3 * (thread_seconds() - begin), result.converged};
}

#else

struct SmallGicpScan::Impl {};

bool has_small_gicp() {
  return false;
}

SmallGicpScan::SmallGicpScan(const PointCloud&, double) {}

SmallGicpAlignment small_gicp_align(const SmallGicpScan&, const SmallGicpScan&, const Eigen::Isometry3d&,
                                    bool) {
  return {};
}

#endif

SmallGicpScan::~SmallGicpScan() = default;

}  // namespace loopwise::bench
