// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/align.hpp>

#include <limits>
#include <memory>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {
namespace {

std::shared_ptr<const PointCloud> finite_cloud(PointView points, const char* name, std::size_t& dropped) {
  constexpr double kCoarse_m = 16384.0;  // floats beyond are at least 2 mm apart
  auto cloud = std::make_shared<PointCloud>();
  cloud->points.reserve(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3f single = points[i].cast<float>();
    if (single.allFinite()) cloud->points.push_back(single);
  }
  dropped = points.size() - cloud->size();
  if (!cloud->empty() && robust_centre(cloud->points).norm() > kCoarse_m) {
    throw InputError(
        std::string("align: the ") + name +
        " is in world coordinates, where a float loses digits: subtract an offset from its points");
  }
  return cloud;
}

}  // namespace

AlignResult align(PointView target, PointView source, const AlignOptions& options) {
  constexpr Key kTarget = 0, kSource = 1;
  if (!(options.time_limit_s >= 0.0)) {
    throw OptionError("align: time_limit_s = " + std::to_string(options.time_limit_s) + ", must be >= 0");
  }
  if (options.guess &&
      !(se3::rotation_defect(options.guess->linear()) <= 1e-3 && options.guess->matrix().allFinite())) {
    throw InputError("align: the guess is not a rigid transform");
  }
  AlignResult out;
  const auto target_cloud = finite_cloud(target, "target", out.dropped_target_points);
  const auto source_cloud = finite_cloud(source, "source", out.dropped_source_points);
  const auto features = std::make_shared<FeatureCache>(
      [&](Key key) { return key == kSource ? source_cloud : target_cloud; }, options.features);
  // As a pair of nodes: `from` is the source, so that T_from_to is T_source_target.
  RegistrationTask task = pair_task(kSource, kTarget, /*seed=*/1);
  task.time_limit_s = options.time_limit_s;
  if (options.guess) task.guess_from_to = se3::normalized(*options.guess).inverse();
  const RegistrationResult result = FastRegistrar(features, options.registration).compute(task);

  out.success = result.verified();
  out.reason = result.reason;
  out.message = result.message;
  out.inlier_share = result.overlap;
  out.dropped_target_points += points_beyond(*target_cloud, options.features.max_range_m);
  out.dropped_source_points += points_beyond(*source_cloud, options.features.max_range_m);
  if (out.success) {
    out.T_target_source = result.closure->T_from_to.inverse();
    out.covariance = se3::covariance_of_inverse(result.closure->T_from_to, result.closure->covariance);
  } else {
    out.T_target_source.matrix().topRows<3>().setConstant(std::numeric_limits<double>::quiet_NaN());
    out.covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return out;
}

}  // namespace loopwise
