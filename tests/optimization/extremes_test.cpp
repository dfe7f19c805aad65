// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Numbers as far out as missions may have them: coordinates, weights, rotations, components, outliers.
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "support.hpp"

namespace loopwise::extremes_test {
namespace {

constexpr double kPi = 3.14159265358979323846;

/// The graph seen from another world frame: nodes and priors move, measurements between nodes do not.
PoseGraph moved(const PoseGraph& graph, const Eigen::Isometry3d& T_new_old) {
  PoseGraph out;
  for (Node node : graph.nodes()) {
    node.pose = T_new_old * node.pose;
    out.add_node(node);
  }
  for (const Edge& edge : graph.edges()) out.add_edge(edge);
  for (PriorFactor prior : graph.priors()) {
    prior.pose = T_new_old * prior.pose;
    out.add_prior(prior);
  }
  return out;
}

/// All information times a factor, priors as well.
PoseGraph scaled(const PoseGraph& graph, double factor) {
  PoseGraph out;
  for (const Node& node : graph.nodes()) out.add_node(node);
  for (Edge edge : graph.edges()) {
    edge.information *= factor;
    out.add_edge(edge);
  }
  for (PriorFactor prior : graph.priors()) {
    prior.information *= factor;
    out.add_prior(prior);
  }
  return out;
}

/// Largest distance of two estimates of which the second is in the frame that `moved` has made.
struct Distance {
  double m = 0.0;
  double rad = 0.0;
};
Distance distance(const std::vector<Eigen::Isometry3d>& a, const std::vector<Eigen::Isometry3d>& b,
                  const Eigen::Isometry3d& T_b_a) {
  Distance out;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const Eigen::Isometry3d d = (T_b_a * a[i]).inverse() * b[i];
    out.m = std::max(out.m, d.translation().norm());
    out.rad = std::max(out.rad, se3::rotation_angle(d));
  }
  return out;
}

void require_finite(const GncResult& result) {
  for (const double cost :
       {result.optimization.cost_initial, result.optimization.cost, result.truncated_cost}) {
    REQUIRE(std::isfinite(cost));
    REQUIRE(cost >= 0.0);
  }
  for (const double weight : result.weights) REQUIRE((weight >= 0.0 && weight <= 1.0));
  for (const Eigen::Isometry3d& pose : result.optimization.poses) {
    REQUIRE(pose.matrix().allFinite());
    REQUIRE((pose.linear() * pose.linear().transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-9);
  }
}

}  // namespace

TEST_CASE("extremes: a world frame 100 km away changes nothing but the frame",
          "[optimization][extremes][property]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    testing::RandomGraphOptions shape;
    shape.nodes = 80;
    shape.closures = 60;
    shape.false_closures = seed % 2 == 0 ? 40 : 0;
    const PoseGraph here = testing::random_graph(rng, shape).graph;
    Eigen::Isometry3d T = testing::random_pose(rng, 1.0, 3.1);
    T.translation() = Eigen::Vector3d(1e5, -1e5, 1e5);
    const PoseGraph there = moved(here, T);

    const OptimizationResult plain_here = optimize(here), plain_there = optimize(there);
    REQUIRE(plain_there.cost == Approx(plain_here.cost).epsilon(1e-6));
    const GncResult gnc_here = optimize_gnc(here), gnc_there = optimize_gnc(there);
    require_finite(gnc_there);
    REQUIRE(gnc_there.inliers == gnc_here.inliers);
    REQUIRE(gnc_there.truncated_cost == Approx(gnc_here.truncated_cost).epsilon(1e-6));
    const Distance d = distance(gnc_here.optimization.poses, gnc_there.optimization.poses, T);
    CAPTURE(d.m, d.rad);
    REQUIRE(d.m < 1e-5);
    REQUIRE(d.rad < 1e-6);
    // Covariances are relative to each pose: the frame does not show in them.
    const Marginals a = marginals(here), b = marginals(there);
    REQUIRE(b.trace_translation == Approx(a.trace_translation).epsilon(1e-6));
  }
}

TEST_CASE("extremes: information of 1e-6 and 1e6 scales the cost and leaves the poses",
          "[optimization][extremes][property]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    Rng rng(seed);
    const PoseGraph graph = testing::random_graph(rng).graph;
    const OptimizationResult unit = optimize(graph);
    for (const double factor : {1e-6, 1e6}) {
      CAPTURE(seed, factor);
      const OptimizationResult result = optimize(scaled(graph, factor));
      REQUIRE(result.cost == Approx(factor * unit.cost).epsilon(1e-5));
      const Distance d = distance(unit.poses, result.poses, Eigen::Isometry3d::Identity());
      CAPTURE(d.m, d.rad);
      REQUIRE(d.m < 1e-3);
      REQUIRE(d.rad < 1e-3);
      require_finite(optimize_gnc(scaled(graph, factor)));
    }
  }
}

TEST_CASE("extremes: edges of 1e-6 beside edges of 1e6", "[optimization][extremes]") {
  Rng rng(3);
  testing::RandomGraph random = testing::random_graph(rng);
  PoseGraph graph;
  for (const Node& node : random.graph.nodes()) graph.add_node(node);
  for (Edge edge : random.graph.edges()) {
    edge.information = (edge.kind == EdgeKind::kOdometry ? 1e6 : 1e-6) * Matrix6d::Identity();
    graph.add_edge(edge);
  }
  graph.add_prior(testing::prior_at(0, Eigen::Isometry3d::Identity()));
  // Edges of low information do not move poses that edges of high information determine.
  const GncResult result = optimize_gnc(graph);
  require_finite(result);
  const Distance d = distance(random.graph.poses(), result.optimization.poses, Eigen::Isometry3d::Identity());
  CAPTURE(d.m, d.rad);
  REQUIRE(d.m < 1e-3);
}

TEST_CASE("extremes: half turns between nodes", "[optimization][extremes]") {
  for (const double angle : {kPi - 1e-3, kPi - 1e-9, kPi, -kPi, kPi + 1e-9}) {
    CAPTURE(angle);
    Rng rng(7);
    PoseGraph graph;
    std::vector<Eigen::Isometry3d> truth;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    for (Key key = 0; key < 20; ++key) {
      Eigen::Isometry3d step = Eigen::Isometry3d::Identity();
      const Eigen::Vector3d axis = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
      step.linear() = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
      step.translation().x() = 2.0;
      if (key > 0) pose = pose * step;
      truth.push_back(pose);
      Node node;
      node.key = key;
      Vector6d off;
      for (int k = 0; k < 6; ++k) off[k] = 0.05 * rng.normal();
      node.pose = key == 0 ? pose : pose * se3::exp(off);
      graph.add_node(node);
      if (key > 0) graph.add_edge({key - 1, key, step, 100.0 * Matrix6d::Identity(), EdgeKind::kOdometry});
    }
    for (const auto& [from, to] : std::vector<std::pair<Key, Key>>{{19, 0}, {15, 3}, {10, 2}}) {
      graph.add_edge({from, to, truth[from].inverse() * truth[to], 100.0 * Matrix6d::Identity()});
    }
    graph.add_prior(testing::prior_at(0, truth[0]));
    const GncResult result = optimize_gnc(graph);
    require_finite(result);
    REQUIRE(result.optimization.cost < 1e-9);
    const Distance d = distance(truth, result.optimization.poses, Eigen::Isometry3d::Identity());
    CAPTURE(d.m, d.rad);
    REQUIRE(d.m < 1e-4);
    REQUIRE(d.rad < 1e-4);

    // Measured in the other direction, the residual itself is a half turn, where its logarithm is
    // discontinuous.
    PoseGraph wrong = graph;
    Eigen::Isometry3d flipped = truth[18].inverse() * truth[1];
    flipped.linear() *= Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    wrong.add_edge({18, 1, flipped, 100.0 * Matrix6d::Identity()});
    const GncResult without = optimize_gnc(wrong);
    require_finite(without);
    REQUIRE(without.weights.back() < 0.5);
    const OptimizationResult plain = optimize(wrong);
    REQUIRE(std::isfinite(plain.cost));
    REQUIRE(plain.cost <= plain.cost_initial);
  }
}

TEST_CASE("extremes: thousands of robots that share nothing", "[optimization][extremes]") {
  constexpr std::size_t kRobots = 3000, kNodes = 4;
  PoseGraph graph;
  double expected = 0.0;
  for (std::size_t r = 0; r < kRobots; ++r) {
    Rng rng(r + 1);
    testing::RandomGraphOptions shape;
    shape.nodes = kNodes;
    shape.closures = 1;
    shape.prior = r % 2 == 0;
    const PoseGraph own = testing::random_graph(rng, shape).graph;
    const auto key = [r](Key of) { return r * kNodes + of; };
    for (Node node : own.nodes()) {
      node.key = key(node.key);
      graph.add_node(node);
    }
    for (Edge edge : own.edges()) {
      edge.from = key(edge.from);
      edge.to = key(edge.to);
      graph.add_edge(edge);
    }
    for (PriorFactor prior : own.priors()) {
      prior.key = key(prior.key);
      graph.add_prior(prior);
    }
    expected += optimize(own).cost;
  }
  const OptimizationResult plain = optimize(graph);
  REQUIRE(plain.components == kRobots);
  REQUIRE(plain.cost == Approx(expected).epsilon(1e-4));
  const GncResult result = optimize_gnc(graph);
  require_finite(result);
  REQUIRE(result.inliers + result.outliers == kRobots);
  REQUIRE(result.truncated_cost <= plain.cost * (1.0 + 1e-6));
}

TEST_CASE("extremes: a batch of only outliers, for any world origin and any stated information",
          "[optimization][extremes][property]") {
  for (const double information : {1e-6, 1.0, 1e6}) {
    for (std::uint64_t seed = 1; seed <= 3; ++seed) {
      CAPTURE(information, seed);
      Rng rng(seed);
      testing::RandomGraphOptions shape;
      shape.nodes = 120;
      shape.closures = 0;
      PoseGraph graph = testing::random_graph(rng, shape).graph;
      for (int i = 0; i < 400; ++i) {
        const Key from = 60 + rng.below(60), to = rng.below(58);
        graph.add_edge({from, to, testing::random_pose(rng, 1e3), information * Matrix6d::Identity()});
      }
      Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
      T.translation() = Eigen::Vector3d(1e5, 1e5, -1e5);
      for (const bool second_start : {false, true}) {
        GncOptions options;
        options.second_start = second_start;
        const GncResult here = optimize_gnc(graph, {}, options);
        const GncResult there = optimize_gnc(moved(graph, T), {}, options);
        require_finite(here);
        require_finite(there);
        REQUIRE(there.outliers == here.outliers);
        REQUIRE(there.truncated_cost == Approx(here.truncated_cost).epsilon(1e-6));
        const Distance d = distance(here.optimization.poses, there.optimization.poses, T);
        CAPTURE(d.m, d.rad, here.outliers);
        REQUIRE(d.m < 1e-3);
        if (information >= 1.0) REQUIRE(here.outliers == 400);
      }
    }
  }
}

}  // namespace loopwise::extremes_test
