// SPDX-License-Identifier: BSD-3-Clause
#include "gicp.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

#include <Eigen/Cholesky>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/normals.hpp>

#include "normal_bins.hpp"
#include "normal_equations.hpp"
#include "surface.hpp"

namespace loopwise {

std::vector<GicpPass> gicp_passes(double coarse_reach_m, double fine_reach_m, std::size_t coarse_points,
                                  std::size_t fine_points) {
  const double middle = std::sqrt(coarse_reach_m * fine_reach_m);
  return {{coarse_reach_m, coarse_points, 10, 0.02, 2e-3},
          {middle, coarse_points, 10, 0.01, 1e-3},
          {fine_reach_m, coarse_points, 10, 5e-3, 5e-4},
          {fine_reach_m, fine_points, 30, 1e-3, 1e-4}};
}

namespace {

template <class Surface>
GicpResult refine(const Surface& source, const Eigen::Vector3d& source_centre,
                  const std::vector<std::uint32_t>& order, const Surface& target, FollowedPoints& followed,
                  const Eigen::Isometry3d& start, const std::vector<GicpPass>& passes) {
  GicpResult result;
  result.T_target_source = start;

  for (const GicpPass& pass : passes) {
    const std::size_t count = pass.points == 0 ? order.size() : std::min(pass.points, order.size());
    const auto reach = static_cast<float>(pass.reach_m);
    const double sq_scale = pass.reach_m * pass.reach_m / 9.0;
    result.converged = false;
    for (int iteration = 0; iteration < pass.iterations; ++iteration) {
      ++result.iterations;
      const Eigen::Isometry3d& T = result.T_target_source;
      const Eigen::Vector3d centre = T * source_centre;
      NormalEquations equations(sq_scale);
      for (std::size_t k = 0; k < count; ++k) {
        const std::uint32_t i = order[k];
        const Eigen::Vector3d moved = T * source.points[i].template cast<double>();
        const Eigen::Vector3f query = moved.cast<float>();
        const std::optional<Neighbour> nearest = followed.nearest(k, query, reach, target.points);
        if (!nearest) continue;
        const Eigen::Vector3d m = T.linear() * source.normals[i].template cast<double>();
        const Eigen::Vector3d n = target.normals[nearest->index].template cast<double>();
        if (n.dot(m) < 0.0) continue;  // the other face of a wall
        const Eigen::Vector3d d = moved - target.points[nearest->index].template cast<double>();
        equations.add(d, moved - centre, n, m);
      }
      result.points_used = count;
      result.matches = equations.count();
      if (equations.count() < 6) return result;
      equations.finish();
      Matrix6d H = equations.H();
      // Damping keeps directions without constraints where they are.
      H.diagonal().head<3>().array() += 1e-6 * H.diagonal().head<3>().sum();
      H.diagonal().tail<3>().array() += 1e-6 * H.diagonal().tail<3>().sum();
      const Vector6d step = -H.ldlt().solve(equations.b());
      if (!step.allFinite()) return result;
      const Eigen::Matrix3d turn = se3::so3_exp(step.tail<3>());
      Eigen::Isometry3d next = Eigen::Isometry3d::Identity();
      next.linear() = turn * T.linear();
      next.translation() = centre + step.head<3>() - next.linear() * source_centre;
      result.T_target_source = se3::normalized(next);
      const double relative = std::max(step.head<3>().norm() / pass.translation_step_m,
                                       step.tail<3>().norm() / pass.rotation_step_rad);
      // Matches that appear and disappear at the edge of the reach prevent smaller steps.
      result.converged = relative < 5.0;
      if (relative < 1.0) break;
    }
  }
  return result;
}

/// The source points that take part: at most `count`, spread over the directions of surfaces.
std::vector<std::uint32_t> draw_points(const PointNormalView& source, std::size_t count) {
  std::vector<std::uint32_t> order = draw_balanced(source, count);
  const auto gap = [&](std::uint32_t i) { return !source.points()[i].allFinite(); };
  order.erase(std::remove_if(order.begin(), order.end(), gap), order.end());
  return order;
}

}  // namespace

GicpResult refine_gicp(const PointNormalView& source, const Eigen::Vector3d& source_centre,
                       const std::vector<std::uint32_t>& order, const PointNormalView& target,
                       FollowedPoints& followed, const Eigen::Isometry3d& start,
                       const std::vector<GicpPass>& passes) {
  if (is_array(source) && is_array(target)) {
    return refine(arrays_of(source), source_centre, order, arrays_of(target), followed, start, passes);
  }
  return refine(SurfaceReader(source), source_centre, order, SurfaceReader(target), followed, start, passes);
}

GicpResult gicp(const PointNormalView& target, const KdTree& target_tree, const PointNormalView& source,
                const Eigen::Isometry3d& guess_target_source, const GicpOptions& options) {
  validate(options);
  detail::check_tree("gicp", target_tree, target.points());
  detail::check_precision(source.points(), "gicp: the source");
  if (!(se3::rotation_defect(guess_target_source.linear()) <= 1e-3 &&
        guess_target_source.matrix().allFinite())) {
    throw InputError("gicp: the guess is not a rigid transform");
  }
  const bool target_known = check_normals("gicp: target", target);
  const bool source_known = check_normals("gicp: source", source);
  const auto coarse = static_cast<std::size_t>(options.coarse_points);
  const auto fine = static_cast<std::size_t>(options.fine_points);
  const std::vector<std::uint32_t> order = draw_points(source, std::max(coarse, fine));
  const Eigen::Vector3d centre = robust_centre(source.points());
  const Eigen::Isometry3d start = se3::normalized(guess_target_source);
  const std::vector<GicpPass> passes =
      gicp_passes(options.coarse_reach_m, options.fine_reach_m, coarse, fine);
  FollowedPoints followed(target_tree, order.size());
  if (target_known && source_known) {
    return refine_gicp(source, centre, order, target, followed, start, passes);
  }
  return refine(SurfaceReader(source), centre, order, SurfaceReader(target), followed, start, passes);
}

}  // namespace loopwise
