// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/optimization/optimizer.hpp>

#include "pose_problem.hpp"

namespace loopwise::detail {

/// Computes the first estimate of this kind and counts its factorisations. \pre `kind` is not kAuto
[[nodiscard]] std::vector<Pose> first_estimate(Initialization kind, const PoseGraph& graph,
                                               const PoseProblem& problem, const OptimizerOptions& options,
                                               int& factorizations);

/// One of several first estimates.
struct FirstEstimate {
  Initialization kind = Initialization::kFile;
  std::vector<Pose> poses;
  double cost = 0.0;
};
/// The candidates of kAuto, in ascending order of cost. If the graph's own poses cost little more than noise,
/// they are the only candidate. \param cost of poses \param chordal whether to include the chordal estimate
[[nodiscard]] std::vector<FirstEstimate> ranked_estimates(
    const PoseGraph& graph, const PoseProblem& problem, const OptimizerOptions& options, bool chordal,
    const std::function<double(const std::vector<Pose>&)>& cost, int& factorizations);

/// Completes known poses: the other nodes are chained to them as by Initialization::kOdometry.
[[nodiscard]] std::vector<Eigen::Isometry3d> extended(const PoseGraph& graph,
                                                      std::vector<Eigen::Isometry3d> poses,
                                                      std::vector<char> known);

}  // namespace loopwise::detail
