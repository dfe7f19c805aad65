// SPDX-License-Identifier: BSD-3-Clause
#include "pose_scores.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <Eigen/Eigenvalues>

namespace loopwise {
namespace {

/// Cosine of the angle within which two normals agree.
constexpr float kAgreeing = 0.7F;

/// Whether the normal of a target point agrees with n.
bool agrees(const Side& target, const Neighbour& nearest, const Eigen::Vector3f& n) {
  return n.dot(target.submap.cloud().normals[nearest.index]) >= kAgreeing;
}

float plane_distance(const PointCloud& cloud, const Neighbour& nearest, const Eigen::Vector3f& y) {
  return std::abs(cloud.normals[nearest.index].dot(y - cloud.points[nearest.index]));
}

/// Calls visit(position, normal, k) for the first `count` points of `source.order`, moved by T.
template <class Visit>
void for_each(const Side& source, std::size_t count, const Eigen::Isometry3d& T, Visit&& visit) {
  const PointCloud& from = source.submap.cloud();
  const Eigen::Matrix3f R = T.linear().cast<float>();
  for (std::size_t k = 0; k < count; ++k) {
    const std::uint32_t i = source.order[k];
    const Eigen::Vector3f y = (T * from.points[i].cast<double>()).cast<float>();
    const Eigen::Vector3f n = R * from.normals[i];
    visit(y, n, k);
  }
}

}  // namespace

double near_share(const Side& source, std::size_t count, const Side& target,
                  const Eigen::Isometry3d& T_target_source, float reach) {
  count = std::min(count, source.order.size());
  float sum = 0.0F;
  for_each(source, count, T_target_source,
           [&](const Eigen::Vector3f& y, const Eigen::Vector3f& n, std::size_t) {
             const auto nearest = target.submap.tree().nearest(y, reach);
             if (nearest && agrees(target, *nearest, n))
               sum += 1.0F - nearest->sq_distance_m2 / (reach * reach);
           });
  return static_cast<double>(sum) / static_cast<double>(std::max<std::size_t>(1, count));
}

double share_on_surface(const Side& source, std::size_t count, const Side& target,
                        const Eigen::Isometry3d& T_target_source, const ClosureTestOptions& options,
                        FollowedPoints& followed) {
  count = std::min(count, source.order.size());
  const std::vector<Eigen::Vector3f>& points = target.submap.cloud().points;
  const auto within = static_cast<float>(options.plane_distance_m);
  const auto reach = static_cast<float>(options.overlap_distance_m);
  std::size_t on_surface = 0;
  for_each(source, count, T_target_source,
           [&](const Eigen::Vector3f& y, const Eigen::Vector3f& n, std::size_t k) {
             const auto nearest = followed.nearest(k, y, reach, points);
             if (nearest && agrees(target, *nearest, n) &&
                 plane_distance(target.submap.cloud(), *nearest, y) < within)
               ++on_surface;
           });
  return static_cast<double>(on_surface) / static_cast<double>(std::max<std::size_t>(1, count));
}

double contradiction(const Side& source, const Side& target, const Eigen::Isometry3d& T_target_source,
                     std::size_t count) {
  const double found = target.range_image.contradiction(source.submap.cloud(), T_target_source, count) +
                       source.range_image.contradiction(target.submap.parts().front().features->cloud,
                                                        T_target_source.inverse(), count);
  return found - source.range_image.own_contradiction() - target.range_image.own_contradiction();
}

Eigen::Vector3d undecided_share(const Side& source, std::size_t count, const Side& target,
                                const Eigen::Isometry3d& T_target_source, const Eigen::Matrix3d& axes,
                                const ClosureTestOptions& options) {
  // Far enough to find the surface that a point has left. Where the target has no point, as between the rings
  // of a sparse scan, the point decides nothing.
  constexpr float kSeenM = 1.5F;
  constexpr float kAnywhere = 0.005F, kLeastWeight = 1e-3F;
  count = std::min(count, source.order.size());
  const auto within = static_cast<float>(options.plane_distance_m);
  const PointCloud& cloud = target.submap.cloud();
  const Eigen::Matrix3f directions = axes.cast<float>();
  // 1 on the surface, falling smoothly to 0 at twice the distance that counts as on the surface.
  const auto fit_to = [&](const Neighbour& nearest, const Eigen::Vector3f& y, const Eigen::Vector3f& n) {
    if (n.dot(cloud.normals[nearest.index]) < kAgreeing) return 0.0F;
    const float d = plane_distance(cloud, nearest, y) / (2.0F * within);
    return d < 1.0F ? (1.0F - d * d) * (1.0F - d * d) : 0.0F;
  };
  const Eigen::Vector3f anywhere = Eigen::Vector3f::Constant(kAnywhere * static_cast<float>(count));
  std::array<Eigen::Vector3f, 2> here{anywhere, anywhere}, away{anywhere, anywhere};
  for_each(
      source, count, T_target_source, [&](const Eigen::Vector3f& y, const Eigen::Vector3f& n, std::size_t) {
        const auto nearest = target.submap.tree().nearest(y, static_cast<float>(options.overlap_distance_m));
        const float fit = nearest ? fit_to(*nearest, y, n) : 0.0F;
        if (fit == 0.0F) return;
        const Eigen::Vector3f& m = cloud.normals[nearest->index];
        for (Eigen::Index k = 0; k < 3; ++k) {
          // Both normals must face along the axis, so that the noise of one of them does not count.
          const float cosines = std::max(0.0F, directions.col(k).dot(n) * directions.col(k).dot(m));
          const float weight = cosines * cosines;
          if (weight < kLeastWeight) continue;
          for (std::size_t side = 0; side < 2; ++side) {
            const Eigen::Vector3f moved = y + (side == 0 ? 1.0F : -1.0F) * directions.col(k);
            const auto there = target.submap.tree().nearest(moved, kSeenM);
            if (!there) continue;
            here[side][k] += weight * fit;
            away[side][k] += weight * std::min(fit, fit_to(*there, moved, n));
          }
        }
      });
  return away[0].cwiseQuotient(here[0]).cwiseMax(away[1].cwiseQuotient(here[1])).cast<double>();
}

std::array<UndecidedAxis, 3> undecided_axes(const Side& source, std::size_t count, const Side& target,
                                            const Eigen::Isometry3d& T_target_source,
                                            const AlignmentFigures& figures, double free_share,
                                            const ClosureTestOptions& options) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(
      Eigen::Matrix3d(figures.hessian.topLeftCorner<3, 3>()));
  const Eigen::Matrix3d& axes = solver.eigenvectors();
  const Eigen::Vector3d undecided = undecided_share(source, count, target, T_target_source, axes, options);
  std::array<UndecidedAxis, 3> out;
  for (Eigen::Index k = 0; k < 3; ++k) {
    const double free = std::pow(undecided[k] * (1.0 - free_share), 4);
    const double fixed = std::pow((1.0 - undecided[k]) * free_share, 4);
    out[static_cast<std::size_t>(k)] = {axes.col(k), options.max_sigma_m * free / (free + fixed)};
  }
  return out;
}

}  // namespace loopwise
