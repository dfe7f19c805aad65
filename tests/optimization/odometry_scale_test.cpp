// SPDX-License-Identifier: BSD-3-Clause
// Odometry that is worse than its information says, robot by robot.
#include <catch2/catch.hpp>

#include <algorithm>
#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "support.hpp"

namespace loopwise::odometry_scale_test {
namespace {

using namespace loopwise::testing;

constexpr std::size_t kSteps = 150;
constexpr double kSigmaM = 0.02, kSigmaRad = 0.004;

struct Team {
  PoseGraph graph;
  std::vector<Eigen::Isometry3d> truth;
};

/// Robots that walk the same winding loop several times, with closures between rounds and between robots. The
/// odometry of robot r is worse than stated by scale[r]; closures are as stated.
Team team(std::uint64_t seed, const std::vector<double>& scale, std::size_t closures) {
  Rng rng(seed);
  const auto noise = [&](double by) {
    Vector6d xi;
    for (int i = 0; i < 6; ++i) xi[i] = by * (i < 3 ? kSigmaM : kSigmaRad) * rng.normal();
    return se3::exp(xi);
  };
  Vector6d inverse_variance;
  inverse_variance << Eigen::Vector3d::Constant(1.0 / (kSigmaM * kSigmaM)),
      Eigen::Vector3d::Constant(1.0 / (kSigmaRad * kSigmaRad));
  Team out;
  std::vector<Edge> edges;
  std::vector<Key> keys;
  const auto measure = [&](std::size_t a, std::size_t b, double by, EdgeKind kind) {
    Edge edge;
    edge.from = keys[a];
    edge.to = keys[b];
    edge.T_from_to = se3::normalized(out.truth[a].inverse() * out.truth[b] * noise(by));
    edge.information = inverse_variance.asDiagonal();
    edge.kind = kind;
    edges.push_back(edge);
  };
  for (std::size_t robot = 0; robot < scale.size(); ++robot) {
    Eigen::Isometry3d drifted = Eigen::Isometry3d::Identity();
    for (std::size_t i = 0; i < kSteps; ++i) {
      const double angle = 2.0 * 3.14159265358979323846 * static_cast<double>(i) / 50.0;
      Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
      pose.rotate(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()));
      pose.translate(
          Eigen::Vector3d(8.0 + static_cast<double>(robot), 0.0, 0.3 * static_cast<double>(robot)));
      out.truth.push_back(pose);
      keys.push_back((Key{'a'} + robot) << 56U | i);
      const std::size_t node = keys.size() - 1;
      if (i == 0) {
        drifted = pose;
      } else {
        measure(node - 1, node, scale[robot], EdgeKind::kOdometry);
        drifted = se3::normalized(drifted * edges.back().T_from_to);
      }
      Node added;
      added.key = keys.back();
      added.pose = drifted;
      out.graph.add_node(added);
      if (i == 0) out.graph.add_prior(prior_at(added.key, pose, 1e-3));
    }
  }
  for (std::size_t k = 0; k < closures; ++k) {
    const std::size_t a = rng.below(keys.size());
    std::size_t b = rng.below(keys.size());
    while (a == b || a + 1 == b || b + 1 == a) b = rng.below(keys.size());
    measure(a, b, 1.0, EdgeKind::kLoopClosure);
  }
  for (const Edge& edge : edges) out.graph.add_edge(edge);
  return out;
}

double scale_of(const GncResult& result, char robot) {
  for (const OdometryScale& entry : result.odometry_scales) {
    if (entry.first >> 56U == static_cast<Key>(robot)) return entry.scale;
  }
  return 1.0;
}

double mean_error(const GncResult& result, const Team& team) {
  double sum = 0.0;
  for (std::size_t i = 0; i < team.truth.size(); ++i) {
    sum += (result.optimization.poses[i].translation() - team.truth[i].translation()).norm();
  }
  return sum / static_cast<double>(team.truth.size());
}

GncResult solve(const Team& team, double margin) {
  OptimizerOptions options;
  options.initialization = Initialization::kOdometry;
  GncOptions gnc;
  gnc.odometry_margin = margin;
  return optimize_gnc(team.graph, options, gnc);
}

}  // namespace

TEST_CASE("odometry scale: found for the right robot", "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    const Team robots = team(seed, {1.0, 2.0}, 80);
    const GncResult result = solve(robots, 3.0);
    CHECK(scale_of(result, 'a') < 1.25);
    CHECK(scale_of(result, 'b') == Approx(2.0).epsilon(0.2));
    CHECK(result.optimization.converged);
    for (std::size_t k = 0; k < result.weights.size(); ++k) {
      const Edge& edge = robots.graph.edges()[k];
      if (edge.kind != EdgeKind::kOdometry) continue;
      const double scale = scale_of(result, static_cast<char>(edge.from >> 56U));
      CHECK(result.weights[k] == Approx(1.0 / (scale * scale)));
    }
    // The poses are the minimum for these weights.
    PoseGraph weighted = robots.graph;
    weighted.set_poses(result.optimization.poses);
    for (std::size_t k = 0; k < result.weights.size(); ++k) weighted.set_weight(k, result.weights[k]);
    CHECK(graph_cost(weighted) == Approx(result.optimization.cost).epsilon(1e-9));
    OptimizerOptions file;
    file.initialization = Initialization::kFile;
    CHECK(optimize(weighted, file).cost == Approx(result.optimization.cost).epsilon(1e-6));
  }
}

TEST_CASE("odometry scale: correctly stated odometry keeps its information", "[optimization][gnc]") {
  int found = 0;
  for (std::uint64_t seed = 11; seed <= 30; ++seed) {
    found += solve(team(seed, {1.0, 1.0}, 60), 3.0).odometry_scales.empty() ? 0 : 1;
  }
  CHECK(found <= 1);  // of 40 chains at 1 in 1000 each
}

TEST_CASE("odometry scale: right closures that stated odometry contradicts stay", "[optimization][gnc]") {
  std::size_t lost_before = 0, lost = 0;
  double error_before = 0.0, error = 0.0;
  for (std::uint64_t seed = 41; seed <= 46; ++seed) {
    CAPTURE(seed);
    const Team robots = team(seed, {1.0, 2.5, 2.5}, 60);
    const GncResult without_margin = solve(robots, 1.0), with_margin = solve(robots, 3.0);
    CHECK(without_margin.odometry_scales.empty());
    lost_before += without_margin.outliers;
    lost += with_margin.outliers;
    error_before += mean_error(without_margin, robots);
    error += mean_error(with_margin, robots);
  }
  CAPTURE(lost_before, lost, error_before, error);
  CHECK(lost * 5 < lost_before);
  CHECK(lost < 10);  // of 360
  CHECK(error < error_before);
}

TEST_CASE("odometry scale: chains are those of odometry, not of priors or trusted edges",
          "[optimization][gnc]") {
  Team robots = team(2, {1.0, 2.0}, 80);
  const auto first_of = [](const GncResult& result) {
    std::vector<Key> keys;
    for (const OdometryScale& entry : result.odometry_scales) keys.push_back(entry.first);
    return keys;
  };
  const GncResult apart = solve(robots, 3.0);
  Edge tie;
  tie.from = robots.graph.nodes()[20].key;
  tie.to = robots.graph.nodes()[kSteps + 20].key;
  tie.T_from_to = robots.truth[20].inverse() * robots.truth[kSteps + 20];
  tie.information = 1e4 * Matrix6d::Identity();
  tie.trusted = true;
  robots.graph.add_edge(tie);
  robots.graph.add_prior(prior_at(robots.graph.nodes()[kSteps + 70].key, robots.truth[kSteps + 70], 1e-2));
  const GncResult tied = solve(robots, 3.0);
  CHECK(first_of(apart) == std::vector<Key>{Key{'b'} << 56U});
  CHECK(first_of(tied) == first_of(apart));
  CHECK(scale_of(tied, 'b') == Approx(2.0).epsilon(0.25));
  CHECK(tied.weights[robots.graph.edges().size() - 1] == 1.0);
}

TEST_CASE("odometry scale: not estimated for a chain that nothing else measures", "[optimization][gnc]") {
  Team robots = team(3, {1.0, 2.0, 1.0}, 160);
  // The third robot loses its closures.
  robots.graph.remove_edges_if([](const Edge& edge) {
    return edge.kind != EdgeKind::kOdometry && (edge.from >> 56U == 'c' || edge.to >> 56U == 'c');
  });
  const GncResult result = solve(robots, 3.0);
  CHECK(scale_of(result, 'b') > 1.5);
  CHECK(scale_of(result, 'c') == 1.0);
}

TEST_CASE("odometry scale: a later call may switch it off", "[optimization][gnc]") {
  const Team robots = team(52, {1.0, 2.0}, 80);
  GncOptions gnc;
  gnc.warm_start = true;
  OptimizerOptions options;
  options.initialization = Initialization::kOdometry;
  PoseGraphOptimizer optimizer(options);
  REQUIRE(optimizer.optimize_gnc(robots.graph, gnc).odometry_scales.size() == 1);
  gnc.odometry_margin = 1.0;
  const GncResult off = optimizer.optimize_gnc(robots.graph, gnc);
  CHECK(off.odometry_scales.empty());
  CHECK(off.weights.front() == 1.0);
}

TEST_CASE("odometry scale: continued estimates keep it", "[optimization][gnc]") {
  const Team robots = team(51, {1.0, 2.0}, 90);
  PoseGraph graph = robots.graph;
  std::vector<Edge> later;
  std::size_t number = 0;
  graph.remove_edges_if([&](const Edge& edge) {
    if (edge.kind == EdgeKind::kOdometry || ++number <= 80) return false;
    later.push_back(edge);
    return true;
  });
  OptimizerOptions options;
  options.initialization = Initialization::kOdometry;
  GncOptions gnc;
  gnc.warm_start = true;
  PoseGraphOptimizer optimizer(options);
  const GncResult first = optimizer.optimize_gnc(graph, gnc);
  CHECK(first.fresh);
  REQUIRE(first.odometry_scales.size() == 1);
  for (const Edge& edge : later) graph.add_edge(edge);
  const GncResult second = optimizer.optimize_gnc(graph, gnc);
  CHECK_FALSE(second.fresh);
  REQUIRE(second.odometry_scales.size() == 1);
  CHECK(second.odometry_scales[0].scale == first.odometry_scales[0].scale);
  CHECK(second.inliers >= first.inliers);
}

}  // namespace loopwise::odometry_scale_test
