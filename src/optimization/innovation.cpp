// SPDX-License-Identifier: BSD-3-Clause
#include "innovation.hpp"

#include <limits>

#include <Eigen/Dense>

#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "odometry_forest.hpp"

namespace loopwise::detail {

std::vector<double> innovations(const PoseGraph& graph) {
  std::vector<double> out(graph.edges().size(), std::numeric_limits<double>::quiet_NaN());
  const OdometryForest forest(graph);
  for (std::size_t e = 0; e < out.size(); ++e) {
    const Edge& edge = graph.edges()[e];
    if (known_inlier(edge)) continue;
    const auto [from, to] = graph.ends(e);
    const auto path = forest.between(from, to);
    if (!path) continue;
    const Matrix6d ad = se3::adjoint(forest.pose(to).inverse());
    const Matrix6d prediction = ad * *path * ad.transpose();
    const Vector6d r = edge_residual(edge, forest.pose(from), forest.pose(to));
    // S⁻¹ = (I + ΩP)⁻¹Ω holds for a semi-definite Ω too.
    const Matrix6d m = Matrix6d::Identity() + edge.information * prediction;
    out[e] = r.dot(m.partialPivLu().solve(edge.information * r));
  }
  return out;
}

}  // namespace loopwise::detail
