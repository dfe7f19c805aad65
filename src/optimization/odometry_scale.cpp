// SPDX-License-Identifier: BSD-3-Clause
#include "odometry_scale.hpp"

#include <algorithm>
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>

namespace loopwise::detail {
namespace {

/// Odometry is not taken for worse than stated unless chance alone is this unlikely to make it look so.
constexpr double kSignificance = 0.999;

double of_tree(const OdometryVariances& variances, std::uint32_t root) {
  const auto found = variances.find(root);
  return found == variances.end() ? 1.0 : found->second;
}

/// Sums over the odometry of one tree.
struct Sums {
  double squares = 0.0;     ///< rᵀΩr
  double redundancy = 0.0;  ///< 6 − tr(Ω J Σ Jᵀ)
};

}  // namespace

PoseGraph with_odometry_variances(const PoseGraph& graph, const OdometryForest& forest,
                                  const OdometryVariances& variances) {
  PoseGraph out = graph;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    const Edge& edge = graph.edges()[k];
    if (edge.kind != EdgeKind::kOdometry) continue;
    const double variance = of_tree(variances, forest.root(graph.ends(k).from));
    if (variance > 1.0) out.set_information(k, edge.information / variance);
  }
  return out;
}

OdometryVariances odometry_variances(const PoseGraph& graph, const OdometryForest& forest,
                                     const std::vector<Eigen::Isometry3d>& poses,
                                     const std::vector<double>& weights, const OdometryVariances& variances,
                                     double largest) {
  PoseGraph at_minimum = graph;
  at_minimum.set_poses(poses);
  for (std::size_t k = 0; k < weights.size(); ++k) at_minimum.set_weight(k, weights[k]);
  std::vector<std::size_t> odometry;
  std::vector<std::pair<std::size_t, std::size_t>> ends;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    if (graph.edges()[k].kind != EdgeKind::kOdometry) continue;
    odometry.push_back(k);
    ends.emplace_back(graph.ends(k).from, graph.ends(k).to);
  }
  std::vector<Matrix12d> joint;
  try {
    joint = HessianFactor(at_minimum).joint(ends);
  } catch (const InputError&) {
    return variances;  // the factors leave a pose open: there are no covariances
  }
  const double degrees_of_freedom = graph.degrees_of_freedom();
  std::map<std::uint32_t, Sums> sums;
  for (std::size_t i = 0; i < odometry.size(); ++i) {
    const Edge& edge = graph.edges()[odometry[i]];
    const Eigen::Isometry3d &from = poses[ends[i].first], &to = poses[ends[i].second];
    const Vector6d r = edge_residual(edge, from, to);
    Eigen::Matrix<double, 6, 12> J;
    J.rightCols<6>() = se3::right_jacobian_inverse(r);
    J.leftCols<6>() = -J.rightCols<6>() * se3::adjoint(to.inverse() * from);
    Sums& of_tree = sums[forest.root(ends[i].first)];
    of_tree.squares += r.dot(edge.information * r);
    of_tree.redundancy += degrees_of_freedom - (edge.information * J * joint[i] * J.transpose()).trace();
  }
  OdometryVariances out;
  for (const auto& [root, sum] : sums) {
    const double before = of_tree(variances, root);
    const int degrees = static_cast<int>(std::floor(sum.redundancy));
    // By the stated information.
    const bool significant =
        degrees >= 1 && before * sum.squares > chi_squared_quantile(kSignificance, degrees);
    double variance = significant ? before * sum.squares / sum.redundancy : degrees >= 1 ? 1.0 : before;
    variance = std::clamp(variance, 1.0, largest);
    if (variance > 1.0) out[root] = variance;
  }
  return out;
}

}  // namespace loopwise::detail
