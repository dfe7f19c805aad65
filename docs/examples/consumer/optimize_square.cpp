// SPDX-License-Identifier: BSD-3-Clause
// A robot drives around a square with drifting odometry. One of its two loop closures is false: the robust
// back end detects it and closes the square.
#include <cstdio>

#include <loopwise/optimization/gnc.hpp>

int main() {
  using namespace loopwise;
  constexpr double kSide = 10.0;
  constexpr double kQuarterTurn = 1.5707963267948966;
  Vector6d forward, drift;
  forward << kSide, 0.0, 0.0, 0.0, 0.0, 0.0;
  drift << 0.2, 0.1, 0.05, 0.0, 0.0, 0.02;
  Vector6d turn = Vector6d::Zero();
  turn[5] = kQuarterTurn;
  const Eigen::Isometry3d step = se3::exp(forward) * se3::exp(turn);
  const Eigen::Isometry3d measured = step * se3::exp(drift);

  PoseGraph graph;
  Node node;
  for (Key key = 0; key <= 4; ++key) {
    node.key = key;
    graph.add_node(node);
    if (key > 0) graph.add_edge({key - 1, key, measured, 100.0 * Matrix6d::Identity(), EdgeKind::kOdometry});
    node.pose = node.pose * measured;
  }
  graph.add_edge({4, 0, Eigen::Isometry3d::Identity(), 400.0 * Matrix6d::Identity()});  // back at the start
  graph.add_edge(
      {3, 1, Eigen::Isometry3d::Identity(), 400.0 * Matrix6d::Identity()});  // another place: false

  const GncResult result = optimize_gnc(graph);
  const double gap_before = graph.node(4).pose.translation().norm();
  const double gap_after =
      (result.optimization.poses[0].inverse() * result.optimization.poses[4]).translation().norm();
  std::printf("gap %.2f m before, %.3f m after; weights of the closures: %g (true), %g (false)\n", gap_before,
              gap_after, result.weights[4], result.weights[5]);
  return gap_after < 0.1 * gap_before && result.weights[4] > 0.5 && result.weights[5] < 0.5 ? 0 : 1;
}
