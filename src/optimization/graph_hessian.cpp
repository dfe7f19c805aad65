// SPDX-License-Identifier: BSD-3-Clause
#include "graph_hessian.hpp"

#include "pose_problem.hpp"

namespace loopwise::detail {

static_assert(GraphHessian::kHeld == Freedom::kFixed);

GraphHessian::GraphHessian(const PoseGraph& graph) : blocks(6) {
  const PoseProblem problem(graph);
  const std::vector<Pose> poses = problem.poses_of(graph.poses());
  ThreadPool pool(1);
  std::vector<Vector6d> residuals;
  problem.cost(poses, pool, residuals);
  SystemStructure structure(problem);
  blocks.lay_out(structure.freedom.nodes.size(), structure.pairs);
  Eigen::VectorXd gradient(6 * static_cast<Eigen::Index>(structure.freedom.nodes.size()));
  linearize(problem, structure, poses, residuals, pool, blocks, gradient);
  variable = std::move(structure.freedom.variable);
  variable.pop_back();  // the fixed node at the origin
  nodes = std::move(structure.freedom.nodes);
}

}  // namespace loopwise::detail
