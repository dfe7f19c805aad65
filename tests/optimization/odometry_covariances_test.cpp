// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/odometry_covariances.hpp>

#include <loopwise/optimization/marginals.hpp>

#include "support.hpp"

namespace loopwise::odometry_covariances_test {
namespace {

constexpr Key kNodes = 8;

/// Two robots of four nodes each, with odometry of random information, without closures and priors.
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

OdometryCovariances of(const PoseGraph& graph) {
  OdometryCovariances covariances;
  covariances.update(graph);
  return covariances;
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
      const auto covariance = of(graph).between(from, to);
      REQUIRE(covariance);
      const Matrix6d expected = by_joint_covariance(graph, from, to);
      REQUIRE((*covariance - expected).norm() < 1e-6 * expected.norm());
    }
  }
}

TEST_CASE("odometry_covariances: closures, also trusted ones, and estimates do not change them",
          "[optimization]") {
  Rng rng(52);
  PoseGraph graph = two_robots(rng);
  OdometryCovariances covariances = of(graph);
  const auto before = covariances.between(3, 0);
  REQUIRE(before);
  Edge closure;
  closure.information = testing::random_information(rng, 100.0);
  for (const auto& [from, to] : {std::pair<Key, Key>{5, 1}, {3, 0}}) {
    closure.from = from;
    closure.to = to;
    graph.set_trusted(graph.add_edge(closure), true);
  }
  for (const Key key : graph.keys()) graph.set_pose(key, testing::random_pose(rng, 5.0));
  covariances.update(graph);
  for (const OdometryCovariances& c : {covariances, of(graph)}) {
    REQUIRE_FALSE(c.between(5, 1));
    REQUIRE(c.between(3, 0) == before);
    REQUIRE_FALSE(c.between(99, 0));
  }
}

TEST_CASE("odometry_covariances: a growing graph gives the same as the whole one",
          "[optimization][property]") {
  Rng rng(53);
  for (int trial = 0; trial < 20; ++trial) {
    CAPTURE(trial);
    const PoseGraph whole = two_robots(rng);
    PoseGraph growing;
    OdometryCovariances covariances;
    // The robots' nodes in turns. A prior or an edge of odometry between the robots may come at any time.
    const std::size_t when = rng.below(kNodes);
    for (std::size_t k = 0; k < kNodes; ++k) {
      const Key key = k % 2 == 0 ? k / 2 : kNodes / 2 + k / 2;
      growing.add_node(whole.node(key));
      for (const Edge& edge : whole.edges()) {
        if (edge.to != key) continue;
        growing.add_edge(edge);
        if (rng.uniform() < 0.3) growing.add_edge(edge);  // a second odometry
      }
      if (k == when && trial % 2 == 0) {
        for (const Key first : {Key{0}, kNodes / 2}) {
          if (growing.contains(first))
            growing.add_prior(testing::prior_at(first, whole.node(first).pose, 100.0));
        }
      }
      if (k == kNodes - 1 && trial % 4 == 1) {
        Edge tie;
        tie.from = 2;
        tie.to = 5;
        tie.T_from_to = testing::random_pose(rng, 1.0);
        tie.information = testing::random_information(rng, 100.0);
        tie.kind = EdgeKind::kOdometry;
        growing.add_edge(tie);
      }
      covariances.update(growing);
      const OdometryCovariances fresh = of(growing);
      for (std::size_t a = 0; a <= k; ++a) {
        for (std::size_t b = 0; b <= k; ++b) REQUIRE(covariances.between(a, b) == fresh.between(a, b));
      }
    }
    REQUIRE((trial % 2 == 0 && when > 0) == (trial % 4 != 1 && covariances.between(1, 2).has_value()));
  }
}

}  // namespace loopwise::odometry_covariances_test
