// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/auxiliary_factors.hpp>

#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>

#include "support.hpp"

namespace loopwise::auxiliary_factors_test {
namespace {

Eigen::Vector3d down() {
  return -Eigen::Vector3d::UnitZ();
}

GravityFactor gravity_at(Key key, const Eigen::Vector3d& direction, double sigma_rad) {
  GravityFactor gravity;
  gravity.key = key;
  gravity.direction = direction;
  gravity.sigma_rad = sigma_rad;
  return gravity;
}

PoseGraph with_auxiliary_factors(Rng& rng, bool prior = true) {
  testing::RandomGraphOptions shape;
  shape.prior = prior;
  testing::RandomGraph random = testing::random_graph(rng, shape);
  testing::add_auxiliary_factors(random, rng);
  return random.graph;
}

/// Hessian of the auxiliary factors' cost by central differences of their residuals.
Eigen::MatrixXd auxiliary_hessian(const PoseGraph& graph) {
  const auto n = static_cast<Eigen::Index>(graph.nodes().size());
  const auto rows = static_cast<Eigen::Index>(graph.ranges().size() + 3 * graph.gravities().size());
  const auto residuals = [&](const std::vector<Eigen::Isometry3d>& poses) {
    Eigen::VectorXd r(rows);
    Eigen::Index row = 0;
    for (const RangeFactor& f : graph.ranges()) {
      r[row++] = linearize(f, poses[graph.index_of(f.from)], poses[graph.index_of(f.to)]).r;
    }
    for (const GravityFactor& f : graph.gravities()) {
      r.segment<3>(row) = linearize(f, poses[graph.index_of(f.key)]).r;
      row += 3;
    }
    return r;
  };
  Eigen::MatrixXd J(rows, 6 * n);
  constexpr double h = 1e-5;
  for (Eigen::Index k = 0; k < 6 * n; ++k) {
    const auto shifted = [&](double by) {
      std::vector<Eigen::Isometry3d> poses = graph.poses();
      Vector6d xi = Vector6d::Zero();
      xi[k % 6] = by;
      Eigen::Isometry3d& pose = poses[static_cast<std::size_t>(k / 6)];
      pose = pose * se3::exp(xi);
      return residuals(poses);
    };
    J.col(k) = (shifted(h) - shifted(-h)) / (2.0 * h);
  }
  return J.transpose() * J;
}

}  // namespace

TEST_CASE("auxiliary factors: residuals and Jacobians", "[optimization][property]") {
  Rng rng(1);
  for (int trial = 0; trial < 50; ++trial) {
    const Eigen::Isometry3d a = testing::random_pose(rng, 10.0), b = testing::random_pose(rng, 10.0);
    const RangeFactor range{0, 1, rng.uniform(0.0, 20.0), rng.uniform(0.1, 2.0)};
    const LinearizedRange l = linearize(range, a, b);
    REQUIRE(l.r == Approx(((a.translation() - b.translation()).norm() - range.range_m) / range.sigma_m));
    Eigen::Vector3d direction(rng.normal(), rng.normal(), rng.normal());
    PoseGraph graph;
    graph.add_node({});
    graph.add_gravity(gravity_at(0, 9.81 * direction, 0.3));  // of any length
    const GravityFactor& gravity = graph.gravities().front();
    const LinearizedGravity g = linearize(gravity, a);
    const double angle = std::acos((a.linear() * direction.normalized()).dot(down()));
    REQUIRE(g.r.norm() == Approx(2.0 * std::sin(0.5 * angle) / 0.3));

    constexpr double h = 1e-6;
    for (int k = 0; k < 6; ++k) {
      Vector6d xi = Vector6d::Zero();
      xi[k] = h;
      const Eigen::Isometry3d plus = se3::exp(xi), minus = se3::exp(-xi);
      const auto slope = [&](const auto& high, const auto& low) { return (high - low) / (2.0 * h); };
      // Measured 4e-9; the Jacobians are of size 1 to 10.
      REQUIRE(std::abs(l.J_from[k] -
                       slope(linearize(range, a * plus, b).r, linearize(range, a * minus, b).r)) < 1e-7);
      REQUIRE(std::abs(l.J_to[k] - slope(linearize(range, a, b * plus).r, linearize(range, a, b * minus).r)) <
              1e-7);
      const Eigen::Vector3d numeric = slope(linearize(gravity, a * plus).r, linearize(gravity, a * minus).r);
      REQUIRE((g.J.col(k) - numeric).norm() < 1e-7);
    }
  }
  const Eigen::Isometry3d pose = testing::random_pose(rng);
  const LinearizedRange nowhere = linearize(RangeFactor{0, 1, 2.0, 0.5}, pose, pose);
  REQUIRE(nowhere.r == -4.0);
  REQUIRE((nowhere.J_from.isZero() && nowhere.J_to.isZero()));
}

TEST_CASE("auxiliary factors: covariances equal dense inversion", "[optimization][property]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    const PoseGraph graph = with_auxiliary_factors(rng);
    const Eigen::MatrixXd dense = (testing::dense_hessian(graph) + auxiliary_hessian(graph)).inverse();
    const Marginals result = marginals(graph);
    for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
      const auto at = 6 * static_cast<Eigen::Index>(i);
      const Matrix6d expected = dense.block<6, 6>(at, at);
      REQUIRE((result.covariances[i] - expected).cwiseAbs().maxCoeff() <
              1e-6 * expected.cwiseAbs().maxCoeff());
    }
  }
}

TEST_CASE("auxiliary factors: at the optimum the gradient is 0 and the cost is the sum of its parts",
          "[optimization][property]") {
  for (const bool prior : {true, false}) {
    Rng rng(7);
    PoseGraph graph = with_auxiliary_factors(rng, prior);
    const OptimizationResult result = optimize(graph);
    REQUIRE(result.converged);
    REQUIRE(result.cost < result.cost_initial);
    graph.set_poses(result.poses);
    REQUIRE(graph_cost(graph) == Approx(result.cost).epsilon(1e-9));
    // No single pose can be moved to lower the cost.
    for (std::size_t node = prior ? 0 : 1; node < graph.nodes().size(); node += 4) {
      for (int k = 0; k < 6; ++k) {
        for (const double by : {-1e-4, 1e-4}) {
          PoseGraph moved = graph;
          Vector6d xi = Vector6d::Zero();
          xi[k] = by;
          moved.set_pose(graph.nodes()[node].key, graph.nodes()[node].pose * se3::exp(xi));
          REQUIRE(graph_cost(moved) > result.cost);
        }
      }
    }
    const GncResult robust = optimize_gnc(graph);
    REQUIRE(robust.truncated_cost == Approx(result.cost).epsilon(1e-6));
  }
}

TEST_CASE("auxiliary factors: gravity takes the tilt out of drifting odometry", "[optimization]") {
  Rng rng(3);
  testing::RandomGraphOptions shape;
  shape.closures = 0;
  shape.nodes = 100;
  shape.sigma_rad = 0.02;
  testing::RandomGraph random = testing::random_graph(rng, shape);
  const auto worst_tilt = [&](const std::vector<Eigen::Isometry3d>& poses) {
    double worst = 0.0;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const Eigen::Vector3d there = poses[i].linear().transpose() * down();
      const Eigen::Vector3d truth = random.truth[i].linear().transpose() * down();
      worst = std::max(worst, std::acos(std::min(1.0, there.dot(truth))));
    }
    return worst;
  };
  const double before = worst_tilt(random.graph.poses());
  for (Key key = 0; key < 100; ++key) {
    random.graph.add_gravity(gravity_at(key, random.truth[key].linear().transpose() * down(), 0.001));
  }
  const OptimizationResult result = optimize(random.graph);
  REQUIRE(result.converged);
  REQUIRE(worst_tilt(result.poses) < 0.02 * before);
}

TEST_CASE("auxiliary factors: ranges place a radio anchor", "[optimization]") {
  Rng rng(5);
  testing::RandomGraphOptions shape;
  shape.sigma_m = shape.sigma_rad = 1e-5;
  testing::RandomGraph random = testing::random_graph(rng, shape);
  const Eigen::Vector3d anchor(4.0, 9.0, -2.0);
  Node node;
  node.key = make_key('u', 0);
  node.pose.translation() = anchor + Eigen::Vector3d(1.5, -1.0, 2.0);
  random.graph.add_node(node);
  PriorFactor weak{node.key, node.pose, Matrix6d::Identity()};
  weak.information.topLeftCorner<3, 3>() *= 1e-6;
  random.graph.add_prior(weak);
  for (Key key = 0; key < 30; key += 2) {
    random.graph.add_range({key, node.key, (random.truth[key].translation() - anchor).norm(), 0.01});
  }
  const OptimizationResult result = optimize(random.graph);
  REQUIRE(result.converged);
  REQUIRE((result.poses.back().translation() - anchor).norm() < 1e-3);
  random.graph.set_poses(result.poses);
  REQUIRE(marginals(random.graph).covariances.back().topLeftCorner<3, 3>().trace() < 0.01);
}

TEST_CASE("auxiliary factors: bad numbers are refused, and nothing changes", "[optimization][error]") {
  PoseGraph graph;
  for (Key key = 0; key < 2; ++key) {
    Node node;
    node.key = key;
    graph.add_node(node);
  }
  const double nan = std::numeric_limits<double>::quiet_NaN();
  REQUIRE_THROWS_AS(graph.add_range({0, 7, 1.0, 1.0}), UnknownKeyError);
  REQUIRE_THROWS_WITH(graph.add_range({1, 1, 1.0, 1.0}), "range 1 to 1: both ends are the same node");
  REQUIRE_THROWS_AS(graph.add_range({0, 1, -1.0, 1.0}), InputError);
  REQUIRE_THROWS_AS(graph.add_range({0, 1, nan, 1.0}), InputError);
  REQUIRE_THROWS_AS(graph.add_range({0, 1, 1.0, 0.0}), InputError);
  REQUIRE_THROWS_AS(graph.add_gravity(gravity_at(9, down(), 1.0)), UnknownKeyError);
  REQUIRE_THROWS_WITH(graph.add_gravity(gravity_at(1, Eigen::Vector3d::Zero(), 1.0)),
                      "gravity at 1: direction has no length");
  REQUIRE_THROWS_AS(graph.add_gravity(gravity_at(1, {nan, 0.0, 1.0}, 1.0)), InputError);
  REQUIRE_THROWS_AS(graph.add_gravity(gravity_at(1, down(), -1.0)), InputError);
  REQUIRE((graph.ranges().empty() && graph.gravities().empty()));
}

}  // namespace loopwise::auxiliary_factors_test
