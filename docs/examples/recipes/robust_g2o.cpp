// SPDX-License-Identifier: BSD-3-Clause
// robust_g2o GRAPH: false closures of a g2o file, and how certain the poses are without them.
#include <cmath>
#include <cstdio>

#include <loopwise/io/g2o.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>

int main(int argc, char** argv) {
  using namespace loopwise;
  if (argc != 2) return 2;
  PoseGraph graph = read_g2o(argv[1]).graph;  // edges between neighbours of a robot are odometry
  const GncResult robust = optimize_gnc(graph);
  graph.set_poses(robust.optimization.poses);
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    graph.set_weight(e, robust.weights[e]);
    const Edge& edge = graph.edges()[e];
    if (edge.kind == EdgeKind::kLoopClosure && edge.weight < 0.5)
      std::printf("false closure: %s - %s\n", key_name(edge.from).c_str(), key_name(edge.to).c_str());
  }
  const Marginals known = marginals(graph);  // order [x y z rx ry rz], frame of the body
  std::printf("%zu of %zu closures kept; sigma of the last node: %.3f m\n", robust.inliers,
              robust.inliers + robust.outliers,
              std::sqrt(known.covariances.back().topLeftCorner<3, 3>().trace()));
}
