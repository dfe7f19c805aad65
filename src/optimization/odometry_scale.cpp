// SPDX-License-Identifier: BSD-3-Clause
#include "odometry_scale.hpp"

#include <algorithm>
#include <cmath>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>

#include "odometry_forest.hpp"

namespace loopwise::detail {
namespace {

/// Odometry counts as worse than stated only if its residuals exceed this quantile of chance.
constexpr double kSignificance = 0.999;
/// Variances above the largest allowed one by less than this factor are as good as that: of long chains, any
/// difference is significant.
constexpr double kNoticeable = 1.1;

double of_chain(const OdometryVariances& variances, std::uint32_t chain) {
  const auto found = variances.find(chain);
  return found == variances.end() ? 1.0 : found->second;
}

/// Sums over one chain.
struct Sums {
  double squares = 0.0;     ///< rᵀΩr
  double redundancy = 0.0;  ///< d − tr(Ω J Σ Jᵀ)
};

/// Whether the sum of squares exceeds the quantile kSignificance.
bool is_significant(double squares, double redundancy) {
  const int degrees = static_cast<int>(std::floor(redundancy));
  if (degrees < 1) return false;
  if (degrees < 1000) return squares > chi_squared_quantile(kSignificance, degrees);
  // Wilson and Hilferty 1931; 3.09 is the quantile of the normal distribution.
  const double n = degrees, cube_root = 1.0 - 2.0 / (9.0 * n) + 3.09 * std::sqrt(2.0 / (9.0 * n));
  return squares > n * cube_root * cube_root * cube_root;
}

}  // namespace

std::vector<std::uint32_t> odometry_chains(const PoseGraph& graph) {
  DisjointSets chains(graph.nodes().size());
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    if (graph.edges()[k].kind == EdgeKind::kOdometry) chains.join(graph.ends(k).from, graph.ends(k).to);
  }
  std::vector<std::uint32_t> out(graph.nodes().size());
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = chains.root(i);
  return out;
}

PoseGraph with_odometry_variances(const PoseGraph& graph, const std::vector<std::uint32_t>& chains,
                                  const OdometryVariances& variances) {
  PoseGraph out = graph;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    const Edge& edge = graph.edges()[k];
    if (edge.kind != EdgeKind::kOdometry) continue;
    const double variance = of_chain(variances, chains[graph.ends(k).from]);
    if (variance > 1.0) out.set_information(k, edge.information / variance);
  }
  return out;
}

std::optional<OdometryEstimate> estimated_odometry_variances(const PoseGraph& graph,
                                                             const std::vector<std::uint32_t>& chains,
                                                             const std::vector<Eigen::Isometry3d>& poses,
                                                             const std::vector<double>& weights,
                                                             const OdometryVariances& variances,
                                                             double largest, bool keep_unmeasured,
                                                             const OptimizerOptions& options) {
  PoseGraph at_minimum = with_odometry_variances(graph, chains, variances);
  at_minimum.set_poses(poses);
  for (std::size_t k = 0; k < weights.size(); ++k) at_minimum.set_weight(k, weights[k]);
  std::vector<std::size_t> odometry;
  std::vector<std::pair<std::size_t, std::size_t>> ends;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    if (graph.edges()[k].kind != EdgeKind::kOdometry || !covariance_of(graph.edges()[k].information))
      continue;
    odometry.push_back(k);
    ends.emplace_back(graph.ends(k).from, graph.ends(k).to);
  }
  std::vector<Matrix12d> joint;
  try {
    joint = HessianFactor(at_minimum, options).joint(ends);
  } catch (const InputError&) {
    return std::nullopt;
  }
  const double degrees_of_freedom = graph.degrees_of_freedom();
  std::map<std::uint32_t, Sums> sums;
  for (std::size_t i = 0; i < odometry.size(); ++i) {
    const Edge& edge = at_minimum.edges()[odometry[i]];
    const Eigen::Isometry3d &from = poses[ends[i].first], &to = poses[ends[i].second];
    const Vector6d r = edge_residual(edge, from, to);
    Eigen::Matrix<double, 6, 12> J;
    J.rightCols<6>() = se3::right_jacobian_inverse(r);
    J.leftCols<6>() = -J.rightCols<6>() * se3::adjoint(to.inverse() * from);
    Sums& chain = sums[chains[ends[i].first]];
    chain.squares += r.dot(edge.information * r);
    chain.redundancy += degrees_of_freedom - (edge.information * J * joint[i] * J.transpose()).trace();
  }
  OdometryEstimate out;
  for (const auto& [chain, sum] : sums) {
    const double before = of_chain(variances, chain);
    out.log_determinant += std::max(0.0, sum.redundancy) * std::log(before);
    if (sum.redundancy < 1.0 && keep_unmeasured && before > 1.0) out.variances[chain] = before;
    if (!is_significant(before * sum.squares, sum.redundancy)) continue;
    const double needed = before * sum.squares / largest;
    if (needed > kNoticeable * sum.redundancy && is_significant(needed, sum.redundancy))
      out.beyond_largest = true;
    const double variance = std::min(before * sum.squares / sum.redundancy, largest);
    if (variance > 1.0) out.variances[chain] = variance;
  }
  return out;
}

}  // namespace loopwise::detail
