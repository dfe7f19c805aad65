// SPDX-License-Identifier: BSD-3-Clause
#include "gicp.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

#include <Eigen/Cholesky>

#include <loopwise/core/se3.hpp>

#include "normal_equations.hpp"

namespace loopwise {

std::vector<GicpPass> gicp_passes(double coarse_reach_m, double fine_reach_m, std::size_t coarse_points,
                                  std::size_t fine_points) {
  const double middle = std::sqrt(coarse_reach_m * fine_reach_m);
  return {{coarse_reach_m, coarse_points, 10, 0.02, 2e-3},
          {middle, coarse_points, 10, 0.01, 1e-3},
          {fine_reach_m, coarse_points, 10, 5e-3, 5e-4},
          {fine_reach_m, fine_points, 30, 1e-3, 1e-4}};
}

GicpResult refine_gicp(const PointCloud& source, const Eigen::Vector3d& source_centre,
                       const std::vector<std::uint32_t>& order, const PointCloud& target,
                       const KdTree& target_tree, const Eigen::Isometry3d& start,
                       const std::vector<GicpPass>& passes) {
  GicpResult result;
  result.T_target_source = start;

  // Steps are small, so the last match of a point bounds the search for its next match.
  constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::vector<std::uint32_t> last(order.size(), kNone);
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
        const Eigen::Vector3d moved = T * source.points[i].cast<double>();
        const Eigen::Vector3f query = moved.cast<float>();
        float bound = reach;
        if (last[k] != kNone) {
          // Exceeds the distance by more than the rounding error, so that the same point is found again.
          bound = std::min(bound, 1.0001F * (target.points[last[k]] - query).norm() + 1e-6F);
        }
        const std::optional<Neighbour> nearest = target_tree.nearest(query, bound);
        if (!nearest) continue;
        last[k] = nearest->index;
        const Eigen::Vector3d m = T.linear() * source.normals[i].cast<double>();
        const Eigen::Vector3d n = target.normals[nearest->index].cast<double>();
        if (n.dot(m) < 0.0) continue;  // the other face of a wall
        const Eigen::Vector3d d = moved - target.points[nearest->index].cast<double>();
        equations.add(d, moved - centre, n, m);
      }
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

}  // namespace loopwise
