// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "odometry_scale.hpp"
#include "pose_problem.hpp"

namespace loopwise::detail {

/// An earlier result of a graph that has grown since.
struct WarmStart {
  std::vector<Pose> poses;  ///< Of all nodes and the fixed one: the earlier ones, and new ones chained on
  std::vector<char> known;  ///< By edge: whether it was there
  std::vector<char> kept;   ///< By edge: whether it was there and kept
  std::size_t left_out_confirmed = 0;  ///< Closures left out that others confirm, by the last fresh solution
  OdometryVariances odometry_variances;  ///< Of the last fresh solution
  bool due = false;  ///< A solution from scratch is due, and the last result not continued
};

/// Robust optimisation from `poses`, which end at the result; fills all of it but poses, components, held,
/// seconds. \param warm where to start first, or null
/// \param left_out_confirmed for the next WarmStart, filled by a fresh solution; null: not wanted
/// \param variances of odometry, as the result has it
/// \returns the components of the result and the nodes that hold them.
/// \throws InputError if the cost of the first estimate is not finite
Freedom solve_gnc(const PoseGraph& graph, const PoseProblem& problem, NormalEquations& equations,
                  std::vector<Pose>& poses, const WarmStart* warm, const OptimizerOptions& options,
                  const GncOptions& gnc, ThreadPool& pool, const StopToken& stop, GncResult& result,
                  std::size_t* left_out_confirmed, OdometryVariances& variances);

constexpr double kKept = 0.5;  ///< A closure of more weight counts as kept

/// Whether a kernel is that of truncated least squares.
[[nodiscard]] inline bool truncates(RobustKernel kernel) {
  return kernel == RobustKernel::kGncTls || kernel == RobustKernel::kTls;
}

/// ½ Σ rᵀΩr over priors and known inliers plus Σ min(½ rᵀΩr, ½ c²) over the closures.
[[nodiscard]] double truncated_cost(const PoseGraph& graph, const PoseProblem& problem,
                                    const std::vector<Pose>& poses, double c2);

}  // namespace loopwise::detail
