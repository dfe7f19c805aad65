// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/cloud_pair.hpp>

#include <utility>

namespace loopwise {
namespace {

// Keys of the pair as two nodes: the source is the newer one.
constexpr Key kTarget = 0, kSource = 1;

}  // namespace

CloudPairResult register_clouds(std::shared_ptr<const PointCloud> source,
                                std::shared_ptr<const PointCloud> target, const RegistrationOptions& options,
                                const std::optional<Eigen::Isometry3d>& guess, std::uint64_t seed) {
  const CloudOrigins coordinates, clouds{target->origin, source->origin};
  RegistrationTask task = pair_task(kSource, kTarget, seed);
  if (guess) task.guess_from_to = clouds.pose_from(coordinates, *guess).inverse();
  const Registration registration =
      make_registration(options, [&](Key key) { return key == kSource ? source : target; });
  CloudPairResult out;
  out.origins = origins_to_report(clouds);
  out.result = registration.registrar->compute(task);
  out.far_points_source = registration.features->get(kSource)->far_points;
  out.far_points_target = registration.features->get(kTarget)->far_points;
  if (out.result.T_from_to) {
    out.T_clouds = out.result.T_from_to->inverse();
    out.T_coordinates = coordinates.pose_from(clouds, *out.T_clouds);
    out.T_origins = out.origins.pose_from(clouds, *out.T_clouds);
  }
  if (out.result.closure) {
    const LoopClosure& closure = *out.result.closure;
    out.covariance = out.origins.covariance_from(
        clouds, se3::covariance_of_inverse(closure.T_from_to, closure.covariance));
  }
  return out;
}

}  // namespace loopwise
