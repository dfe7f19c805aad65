// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "pose_problem.hpp"

namespace loopwise::detail {

/// Robust optimisation from `poses`, which end at the result; fills all of it but poses, components, held,
/// seconds. \returns the components of the result and the nodes that hold them.
Freedom solve_gnc(const PoseGraph& graph, PoseProblem& problem, NormalEquations& equations,
                  std::vector<Pose>& poses, const OptimizerOptions& options, const GncOptions& gnc,
                  ThreadPool& pool, const StopToken& stop, GncResult& result);

}  // namespace loopwise::detail
