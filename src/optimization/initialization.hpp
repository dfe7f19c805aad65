// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/optimization/optimizer.hpp>

#include "pose_problem.hpp"

namespace loopwise::detail {

/// The first estimate of this kind; adds the factorisations that it took. \pre `kind` is not kAuto
[[nodiscard]] std::vector<Pose> first_estimate(Initialization kind, const PoseGraph& graph,
                                               const PoseProblem& problem, const OptimizerOptions& options,
                                               int& factorizations);

/// One of several first estimates.
struct FirstEstimate {
  Initialization kind = Initialization::kFile;
  std::vector<Pose> poses;
  double cost = 0.0;
};
/// What kAuto starts from: the cheapest first. The graph's own poses alone where they cost little more than
/// noise does. \param cost of poses \param chordal whether the chordal estimate is one of them
[[nodiscard]] std::vector<FirstEstimate> ranked_estimates(
    const PoseGraph& graph, const PoseProblem& problem, const OptimizerOptions& options, bool chordal,
    const std::function<double(const std::vector<Pose>&)>& cost, int& factorizations);

/// Poses of all nodes where some are known: the others are chained on as Initialization::kOdometry does.
[[nodiscard]] std::vector<Eigen::Isometry3d> extended(const PoseGraph& graph,
                                                      std::vector<Eigen::Isometry3d> poses,
                                                      std::vector<char> known);

}  // namespace loopwise::detail
