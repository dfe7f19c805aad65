// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <limits>
#include <vector>

#include <loopwise/core/stop_token.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "pose_problem.hpp"

namespace loopwise::detail {

/// Bounds of one call of minimize(), and the damping with which the next call continues.
struct StepControl {
  int max_accepted = std::numeric_limits<int>::max();
  double enough = 0.0;  ///< A step that is predicted to lower the cost by less than this is the last one.
  double damping = 0.0;
};

/// Gauss-Newton with Levenberg-Marquardt damping from `poses`, which are replaced by the best poses. Fills
/// all fields of the result except poses, components, held and seconds; costs and counters are added.
void minimize(const PoseProblem& problem, NormalEquations& equations, std::vector<Pose>& poses,
              const OptimizerOptions& options, StepControl& control, ThreadPool& pool, const StopToken& stop,
              OptimizationResult& result);

/// Sets `termination`, `converged` and `message` of a result.
void set_termination(Termination termination, OptimizationResult& result);

}  // namespace loopwise::detail
