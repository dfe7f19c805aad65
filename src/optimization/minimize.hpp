// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <limits>
#include <vector>

#include <loopwise/core/stop_token.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "pose_problem.hpp"

namespace loopwise::detail {

/// Below this ratio of a pivot to its diagonal element the factors do not determine the pose.
inline constexpr double kSingularPivot = 1e-14;

/// How far one call of minimize() goes, and the damping from which the next call continues.
struct StepControl {
  int max_accepted = std::numeric_limits<int>::max();
  double damping = 0.0;
};

/// Gauss-Newton with Levenberg-Marquardt damping from `poses`, which end at the best seen. Fills everything
/// in the result but poses, components, held and seconds; costs and counters are added.
void minimize(const PoseProblem& problem, NormalEquations& equations, std::vector<Pose>& poses,
              const OptimizerOptions& options, StepControl& control, ThreadPool& pool, const StopToken& stop,
              OptimizationResult& result);

/// Says in a result why it ended: `termination`, `converged` and `message`.
void set_termination(Termination termination, OptimizationResult& result);

}  // namespace loopwise::detail
