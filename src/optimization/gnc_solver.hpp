// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "odometry_scale.hpp"
#include "pose_problem.hpp"

namespace loopwise::detail {

/// An earlier result of a graph that has grown since then.
struct WarmStart {
  std::vector<Pose> poses;  ///< Of all nodes and the fixed one; new nodes are chained to the earlier ones
  std::vector<char> known;  ///< By edge: whether it existed then
  std::vector<char> kept;   ///< By edge: whether it was kept then
  std::size_t left_out_confirmed = 0;    ///< Confirmed closures that the last fresh solution excluded
  OdometryVariances odometry_variances;  ///< Of the last fresh solution
  bool due = false;                      ///< Whether a solution from scratch is due instead
};

/// Robust optimisation from `poses`, which are replaced by the result. Fills all fields of the result except
/// poses, components, held and seconds.
/// \param warm the earlier result to start from first, or null
/// \param left_out_confirmed set by a fresh solution, for the next WarmStart; or null
/// \param variances receives the variance factors of odometry in the result
/// \returns the components of the result and the nodes that hold them.
/// \throws InputError if the cost of the first estimate is not finite
Freedom solve_gnc(const PoseGraph& graph, const PoseProblem& problem, NormalEquations& equations,
                  std::vector<Pose>& poses, const WarmStart* warm, const OptimizerOptions& options,
                  const GncOptions& gnc, ThreadPool& pool, const StopToken& stop, GncResult& result,
                  std::size_t* left_out_confirmed, OdometryVariances& variances);

constexpr double kKept = 0.5;  ///< Closures of a larger weight count as kept

/// Whether the kernel is truncated least squares.
[[nodiscard]] inline bool truncates(RobustKernel kernel) {
  return kernel == RobustKernel::kGncTls || kernel == RobustKernel::kTls;
}

/// ½ Σ rᵀΩr over priors and known inliers plus Σ min(½ rᵀΩr, ½ c²) over the closures.
[[nodiscard]] double truncated_cost(const PoseGraph& graph, const PoseProblem& problem,
                                    const std::vector<Pose>& poses, double c2);

}  // namespace loopwise::detail
