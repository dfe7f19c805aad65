// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include <loopwise/optimization/optimizer.hpp>

#include "pose_problem.hpp"

namespace loopwise::detail {

/// The first estimate that the options ask for; adds the factorisations that it took.
[[nodiscard]] std::vector<Eigen::Isometry3d> first_estimate(const PoseGraph& graph,
                                                            const PoseProblem& problem,
                                                            const OptimizerOptions& options,
                                                            int& factorizations);

}  // namespace loopwise::detail
