// SPDX-License-Identifier: BSD-3-Clause
#include "innovation.hpp"

#include <cmath>

#include <loopwise/optimization/marginals.hpp>

#include "support.hpp"

namespace loopwise::innovation_test {
namespace {

constexpr std::size_t kSteps = 12;

/// Two robots, or one with a gap, chained along noise-free odometry of random information; no closures.
PoseGraph two_chains(Rng& rng) {
  PoseGraph graph;
  Eigen::Isometry3d pose = testing::random_pose(rng, 3.0);
  for (Key k = 0; k < 2 * kSteps; ++k) {
    Edge edge;
    if (k % kSteps == 0) {
      pose = testing::random_pose(rng, 3.0);
    } else {
      edge.from = k - 1;
      edge.to = k;
      edge.T_from_to = testing::random_pose(rng, 1.0);
      edge.information = testing::random_information(rng, 100.0);
      edge.kind = EdgeKind::kOdometry;
      pose = pose * edge.T_from_to;
    }
    Node node;
    node.key = k;
    node.pose = pose;
    graph.add_node(node);
    if (k % kSteps != 0) graph.add_edge(edge);
  }
  return graph;
}

std::size_t add_closure(PoseGraph& graph, Rng& rng, Key from, Key to) {
  Edge edge;
  edge.from = from;
  edge.to = to;
  edge.T_from_to = graph.nodes()[from].pose.inverse() * graph.nodes()[to].pose;
  edge.information = testing::random_information(rng, 100.0);
  graph.add_edge(edge);
  return graph.edges().size() - 1;
}

}  // namespace

TEST_CASE("innovation: that across a neighbour agrees with the joint covariance of the path",
          "[optimization][gnc][property]") {
  Rng rng(31);
  for (int trial = 0; trial < 20; ++trial) {
    CAPTURE(trial);
    PoseGraph graph = two_chains(rng);
    const Key from = rng.below(kSteps), to = kSteps + rng.below(kSteps);
    Key near_from = rng.below(kSteps), near_to = kSteps + rng.below(kSteps);
    if (trial % 2 == 1) std::swap(near_from, near_to);
    const std::size_t kept = add_closure(graph, rng, near_from, near_to);
    // Covariance of all other factors. With a single prior, the kept closure is the only connection between
    // the robots.
    PoseGraph rest = graph;
    rest.add_prior(testing::prior_at(0, rest.nodes()[0].pose));
    for (const Key first : {Key{0}, Key{kSteps}})  // joins the robots' chains, but hardly
      graph.add_prior(testing::prior_at(first, graph.nodes()[first].pose, 100.0));
    const Matrix12d joint = HessianFactor(rest).joint({{from, to}})[0];
    const Eigen::Isometry3d T = graph.nodes()[from].pose.inverse() * graph.nodes()[to].pose;
    Eigen::Matrix<double, 6, 12> J;
    J << -se3::adjoint(T.inverse()), Matrix6d::Identity();
    const Matrix6d prediction = J * joint * J.transpose();

    const std::size_t candidate = add_closure(graph, rng, from, to);
    const Edge& edge = graph.edges()[candidate];
    Vector6d r;
    for (int i = 0; i < 6; ++i) r[i] = rng.normal();
    const Matrix6d S = edge.information.inverse() + prediction;
    const detail::OdometryForest forest(graph);
    detail::NeighbourInnovations neighbours(graph, forest);
    REQUIRE(std::isnan(neighbours(candidate, r).d2));
    neighbours.set_kept({kept});
    const auto innovation = neighbours(candidate, r);
    REQUIRE(innovation.d2 == Approx(r.dot(S.inverse() * r)).epsilon(1e-6));  // the prior's 1e-8
    REQUIRE(innovation.variance == Approx((edge.information * prediction).trace() / 6.0).epsilon(1e-6));
  }
}

TEST_CASE("innovation: a kept closure is not used where odometry is more certain", "[optimization][gnc]") {
  Rng rng(32);
  PoseGraph graph = two_chains(rng);
  const Vector6d r = Vector6d::Ones();
  // Between two nodes of one robot, two steps apart; the kept closure goes the long way round.
  const std::size_t far = add_closure(graph, rng, 0, 11), candidate = add_closure(graph, rng, 5, 7);
  const detail::OdometryForest forest(graph);
  detail::NeighbourInnovations neighbours(graph, forest);
  neighbours.set_kept({far});
  REQUIRE(std::isnan(neighbours(candidate, r).d2));
}

}  // namespace loopwise::innovation_test
