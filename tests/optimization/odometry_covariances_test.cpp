// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/odometry_covariances.hpp>

#include <loopwise/optimization/marginals.hpp>

#include "support.hpp"

namespace loopwise::odometry_covariances_test {
namespace {

constexpr Key kNodes = 8;

/// Two robots of four nodes each with odometry of random information, without closures and priors.
PoseGraph two_robots(Rng& rng) {
  PoseGraph graph;
  for (Key k = 0; k < kNodes; ++k) {
    const bool first = k % (kNodes / 2) == 0;
    Edge step;
    step.from = k - 1;
    step.to = k;
    step.T_from_to = testing::random_pose(rng, 1.0);
    step.information = testing::random_information(rng, 100.0);
    step.kind = EdgeKind::kOdometry;
    Node node;
    node.key = k;
    node.pose = first ? testing::random_pose(rng, 3.0) : graph.nodes().back().pose * step.T_from_to;
    graph.add_node(node);
    if (!first) graph.add_edge(step);
  }
  return graph;
}

LoopCandidate pair_of(Key from, Key to) {
  LoopCandidate candidate;
  candidate.from = from;
  candidate.to = to;
  return candidate;
}

Matrix6d by_joint_covariance(const PoseGraph& graph, Key from, Key to) {
  const Matrix12d joint = HessianFactor(graph).joint({{from, to}})[0];
  const Eigen::Isometry3d T = graph.nodes()[from].pose.inverse() * graph.nodes()[to].pose;
  Eigen::Matrix<double, 6, 12> J;
  J << -se3::adjoint(T.inverse()), Matrix6d::Identity();
  return J * joint * J.transpose();
}

}  // namespace

TEST_CASE("odometry_covariances: they agree with the joint covariance of a graph without closures",
          "[optimization][property]") {
  Rng rng(51);
  for (int trial = 0; trial < 20; ++trial) {
    CAPTURE(trial);
    PoseGraph graph = two_robots(rng);
    for (const Key first : {Key{0}, kNodes / 2})
      graph.add_prior(testing::prior_at(first, graph.nodes()[first].pose, 100.0));
    for (const auto& [from, to] : {std::pair<Key, Key>{0, 3}, {3, 1}, {2, 6}, {7, 1}}) {
      CAPTURE(from, to);
      const auto covariance = odometry_covariances(graph, {pair_of(from, to)}).at(0);
      REQUIRE(covariance);
      const Matrix6d expected = by_joint_covariance(graph, from, to);
      REQUIRE((*covariance - expected).norm() < 1e-6 * expected.norm());
    }
  }
}

TEST_CASE("odometry_covariances: nothing where nothing joins the nodes, and closures do not join them",
          "[optimization]") {
  Rng rng(52);
  PoseGraph graph = two_robots(rng);
  Edge closure;
  closure.from = 5;
  closure.to = 1;
  closure.information = testing::random_information(rng, 100.0);
  const auto before = odometry_covariances(graph, {pair_of(3, 0)});
  graph.add_edge(closure);
  const auto covariances = odometry_covariances(graph, {pair_of(5, 1), pair_of(3, 0), pair_of(99, 0)});
  REQUIRE(covariances.size() == 3);
  REQUIRE_FALSE(covariances[0]);
  REQUIRE(covariances[1] == before[0]);
  REQUIRE_FALSE(covariances[2]);
}

}  // namespace loopwise::odometry_covariances_test
