// SPDX-License-Identifier: BSD-3-Clause
// Planar graphs against a solver of two dimensions that is written here, without SE(3).
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/incremental.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/optimization/pcm.hpp>

#include "support.hpp"

namespace loopwise::planar_test {
namespace {

using Pose2 = Eigen::Vector3d;  // x, y, θ

double wrapped(double angle) {
  return std::atan2(std::sin(angle), std::cos(angle));
}

Pose2 relative(const Pose2& a, const Pose2& b) {
  const Eigen::Rotation2Dd R(-a.z());
  Pose2 out;
  out << R * (b - a).head<2>(), wrapped(b.z() - a.z());
  return out;
}

/// Log of SE(2): the translation by V⁻¹.
Pose2 log2(const Pose2& e) {
  const double half = 0.5 * e.z();
  const double c = std::abs(half) < 1e-9 ? 1.0 : half / std::tan(half);
  return {c * e.x() + half * e.y(), c * e.y() - half * e.x(), e.z()};
}

/// a ⊕ ξ, ξ a tangent vector on the right.
Pose2 moved(const Pose2& a, const Pose2& xi) {
  const double w = xi.z();
  const double s = std::abs(w) < 1e-9 ? 1.0 : std::sin(w) / w;
  const double k = std::abs(w) < 1e-9 ? 0.0 : (1.0 - std::cos(w)) / w;
  const Eigen::Vector2d t(s * xi.x() - k * xi.y(), k * xi.x() + s * xi.y());
  Pose2 out;
  out << a.head<2>() + Eigen::Rotation2Dd(a.z()) * t, wrapped(a.z() + w);
  return out;
}

struct Edge2 {
  std::size_t from, to;
  Pose2 measured;
  Eigen::Matrix3d information;
};

/// Gauss-Newton with numerical Jacobians and a dense Cholesky; node 0 has the prior.
struct Solver2 {
  std::vector<Pose2> poses;
  std::vector<Edge2> edges;
  Pose2 prior;
  double prior_information = 1e8;

  template <class Each>
  void each_residual(Each&& each) const {
    for (const Edge2& e : edges) {
      each(e.from, e.to, e.information,
           [&](const Pose2& a, const Pose2& b) { return log2(relative(e.measured, relative(a, b))); });
    }
    each(std::size_t{0}, std::size_t{0}, Eigen::Matrix3d(prior_information * Eigen::Matrix3d::Identity()),
         [&](const Pose2&, const Pose2& b) { return log2(relative(prior, b)); });
  }

  [[nodiscard]] double cost() const {
    double sum = 0.0;
    each_residual([&](std::size_t a, std::size_t b, const Eigen::Matrix3d& W, auto&& residual) {
      const Pose2 r = residual(poses[a], poses[b]);
      sum += 0.5 * r.dot(W * r);
    });
    return sum;
  }

  [[nodiscard]] Eigen::MatrixXd hessian(Eigen::VectorXd& gradient) const {
    const auto n = static_cast<Eigen::Index>(3 * poses.size());
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
    gradient = Eigen::VectorXd::Zero(n);
    each_residual([&](std::size_t a, std::size_t b, const Eigen::Matrix3d& W, auto&& residual) {
      constexpr double h = 1e-6;
      Eigen::Matrix3d J[2];
      for (int k = 0; k < 3; ++k) {
        const Pose2 d = h * Pose2::Unit(k);
        J[0].col(k) =
            (residual(moved(poses[a], d), poses[b]) - residual(moved(poses[a], -d), poses[b])) / (2 * h);
        J[1].col(k) =
            (residual(poses[a], moved(poses[b], d)) - residual(poses[a], moved(poses[b], -d))) / (2 * h);
      }
      if (a == b) J[0].setZero();
      const Pose2 r = residual(poses[a], poses[b]);
      const Eigen::Index at[2] = {static_cast<Eigen::Index>(3 * a), static_cast<Eigen::Index>(3 * b)};
      for (int i = 0; i < 2; ++i) {
        gradient.segment<3>(at[i]) += J[i].transpose() * W * r;
        for (int j = 0; j < 2; ++j) H.block<3, 3>(at[i], at[j]) += J[i].transpose() * W * J[j];
      }
    });
    return H;
  }

  void solve() {
    for (int i = 0; i < 30; ++i) {
      Eigen::VectorXd g;
      const Eigen::MatrixXd H = hessian(g);
      const Eigen::VectorXd step = H.llt().solve(-g);
      for (std::size_t k = 0; k < poses.size(); ++k)
        poses[k] = moved(poses[k], step.segment<3>(static_cast<Eigen::Index>(3 * k)));
      if (step.norm() < 1e-10) break;
    }
  }
};

Eigen::Isometry3d lifted(const Pose2& p) {
  return planar::pose(p.x(), p.y(), p.z());
}

struct World {
  PoseGraph graph;             ///< Poses chained along noisy odometry, prior on node 0.
  std::vector<Pose2> truth;    ///< By node
  std::vector<bool> is_false;  ///< By edge
  Solver2 solver;              ///< The same in two dimensions, false closures left out
};

/// A drive through the streets of a grid, closures where it comes by again, and false ones between random
/// places.
World grid_world(std::size_t count, std::size_t false_closures, std::uint64_t seed, double sigma_m = 0.02,
                 double sigma_rad = 0.005) {
  constexpr double kStep_m = 2.0;
  constexpr double kQuarter = 1.5707963267948966;
  Rng rng(seed);
  World world;
  world.graph.set_planar();
  const Eigen::Matrix3d information =
      Eigen::Vector3d(1 / (sigma_m * sigma_m), 1 / (sigma_m * sigma_m), 1 / (sigma_rad * sigma_rad))
          .asDiagonal();
  const auto noisy = [&](const Pose2& p) {
    return moved(p, Pose2(sigma_m * rng.normal(), sigma_m * rng.normal(), sigma_rad * rng.normal()));
  };
  std::vector<Edge2> edges;
  Pose2 pose = Pose2::Zero(), estimate = pose;
  for (std::size_t i = 0; i < count; ++i) {
    if (i > 0) {
      const bool corner = i % 5 == 0;
      const double turn = corner ? kQuarter * (static_cast<double>(rng.below(3)) - 1.0) : 0.0;
      // Towards the middle where it would leave the town.
      const bool outside = pose.head<2>().norm() > 30.0;
      Pose2 next = moved(pose, Pose2(0, 0, outside && corner ? kQuarter : turn));
      next.head<2>() += kStep_m * Eigen::Vector2d(std::cos(next.z()), std::sin(next.z()));
      edges.push_back({i - 1, i, noisy(relative(pose, next)), information});
      pose = next;
      Pose2 on;
      on << estimate.head<2>() + Eigen::Rotation2Dd(estimate.z()) * edges.back().measured.head<2>(),
          wrapped(estimate.z() + edges.back().measured.z());
      estimate = on;
    }
    Node node;
    node.key = i;
    node.pose = lifted(estimate);
    world.graph.add_node(node);
    world.truth.push_back(pose);
    world.solver.poses.push_back(estimate);
  }
  for (std::size_t a = 0; a < count; ++a) {
    for (std::size_t b = a + 5; b < count; ++b) {
      if ((world.truth[a] - world.truth[b]).head<2>().norm() > 1.0) continue;
      edges.push_back({a, b, noisy(relative(world.truth[a], world.truth[b])), information});
    }
  }
  world.solver.edges = edges;
  world.solver.prior = Pose2::Zero();
  world.is_false.assign(edges.size(), false);
  for (std::size_t k = 0; k < false_closures; ++k) {
    const std::size_t a = rng.below(count), b = (a + 10 + rng.below(count - 20)) % count;
    edges.push_back({a, b, Pose2(2 * rng.normal(), 2 * rng.normal(), 3 * rng.normal()), information});
    world.is_false.push_back(true);
  }
  for (std::size_t e = 0; e < edges.size(); ++e) {
    Edge edge;
    edge.from = edges[e].from;
    edge.to = edges[e].to;
    edge.T_from_to = lifted(edges[e].measured);
    edge.information = planar::information(edges[e].information);
    edge.kind = e + 1 < count ? EdgeKind::kOdometry : EdgeKind::kLoopClosure;
    world.graph.add_edge(edge);
  }
  world.graph.add_prior(testing::prior_at(0, Eigen::Isometry3d::Identity()));
  return world;
}

double worst_difference(const std::vector<Eigen::Isometry3d>& poses, const std::vector<Pose2>& expected) {
  double worst = 0.0;
  for (std::size_t i = 0; i < poses.size(); ++i)
    worst = std::max(worst, testing::difference(poses[i], lifted(expected[i])));
  return worst;
}

/// Information as programs write it that have no values for z, roll and pitch.
Matrix6d without_across(Matrix6d m) {
  m.block<3, 3>(2, 2).setZero();
  return m;
}

bool all_planar(const std::vector<Eigen::Isometry3d>& poses) {
  return std::all_of(poses.begin(), poses.end(), planar::is_pose);
}

}  // namespace

TEST_CASE("planar: the optimum is that of two dimensions, to the last bit in the plane",
          "[optimization][planar][differential]") {
  const auto seed = GENERATE(range(1u, 6u));
  const auto from = GENERATE(Initialization::kFile, Initialization::kOdometry, Initialization::kChordal);
  CAPTURE(seed, enum_name(from));
  World world = grid_world(120, 0, seed);
  REQUIRE(world.graph.edges().size() > 130);
  OptimizerOptions options;
  options.initialization = from;
  REQUIRE(all_planar(initial_poses(world.graph, from)));
  const OptimizationResult result = optimize(world.graph, options);
  world.solver.solve();
  CHECK(result.converged);
  CHECK(all_planar(result.poses));
  // Measured: 2e-9 m at most, by the numerical Jacobians of the other; cost to 1e-13.
  CHECK(worst_difference(result.poses, world.solver.poses) < 1e-7);
  CHECK(result.cost == Approx(world.solver.cost()).epsilon(1e-9));
}

TEST_CASE("planar: information on z, roll and pitch changes nothing", "[optimization][planar]") {
  const World world = grid_world(100, 20, 3);
  const bool zeros = GENERATE(true, false);
  CAPTURE(zeros);
  const auto across = [&](Matrix6d m) {
    m.block<3, 3>(2, 2) << 0.01, 0, 0, 0, 1e6, 0.5, 0, 0.5, 3.0;
    return zeros ? without_across(m) : m;
  };
  PoseGraph other;
  other.set_planar();
  for (const Node& node : world.graph.nodes()) other.add_node(node);
  for (PriorFactor prior : world.graph.priors()) {
    prior.information = across(prior.information);
    other.add_prior(prior);
  }
  for (Edge edge : world.graph.edges()) {
    edge.information = across(edge.information);
    other.add_edge(edge);
  }
  OptimizerOptions options;
  options.initialization = Initialization::kFile;
  const GncResult a = optimize_gnc(world.graph, options), b = optimize_gnc(other, options);
  CHECK(a.weights == b.weights);
  for (std::size_t i = 0; i < a.optimization.poses.size(); ++i)
    CHECK(testing::difference(a.optimization.poses[i], b.optimization.poses[i]) == 0.0);
  const Certificate certified = certify(world.graph), again = certify(other);
  CHECK(again.status == certified.status);
  CHECK(again.cost == certified.cost);
  CHECK(pairwise_consistent(other).kept == pairwise_consistent(world.graph).kept);
}

TEST_CASE("planar: information is kept as the plane has it, however it comes in", "[optimization][planar]") {
  PoseGraph graph;
  Node node;
  for (node.key = 0; node.key < 2; ++node.key) graph.add_node(node);
  Edge edge;
  edge.to = 1;
  edge.information.diagonal() << 4, 2, 0, 0, 0, 5;
  const Matrix6d stated = edge.information;
  PriorFactor prior;
  prior.information = stated;
  graph.add_edge(edge);
  graph.add_prior(prior);
  graph.set_planar();
  const Matrix6d kept = planar::information(planar::block(stated));
  graph.add_edge(edge);
  graph.add_prior(prior);
  for (const Edge& each : graph.edges()) CHECK(each.information == kept);
  for (const PriorFactor& each : graph.priors()) CHECK(each.information == kept);
  graph.set_information(0, 2.0 * stated);
  CHECK(graph.edges()[0].information == 2.0 * kept);
  // Indefinite within the plane, which a large value across it would hide.
  Matrix6d bad = stated;
  bad(2, 2) = 1e30;
  bad(0, 1) = bad(1, 0) = 10.0;
  CHECK_THROWS_WITH(graph.set_information(0, bad), Contains("indefinite"));

  PoseGraph tied;
  for (const Node& each : graph.nodes()) tied.add_node(each);
  edge.information = Matrix6d::Identity();
  edge.information(0, 2) = edge.information(2, 0) = 0.5;
  tied.add_edge(edge);
  CHECK_THROWS_WITH(tied.set_planar(), Contains("edge 0 to 1") && Contains("couples z"));
  CHECK_FALSE(tied.planar());
  CHECK(tied.edges()[0].information == edge.information);
}

TEST_CASE("planar: a graph that grows is kept at its minimum, not solved from scratch",
          "[optimization][planar][incremental]") {
  const World world = grid_world(120, 0, 4);
  PoseGraph start;
  start.set_planar();
  PriorFactor prior = world.graph.priors()[0];
  prior.information = without_across(prior.information);
  start.add_node(world.graph.nodes()[0]);
  start.add_prior(prior);
  IncrementalOptimizer incremental(start);
  int from_scratch = 0;
  for (std::size_t count = 1; count < world.graph.nodes().size(); ++count) {
    CAPTURE(count);
    incremental.add_node(world.graph.nodes()[count]);
    for (const std::size_t e : world.graph.edges_of(count)) {
      Edge edge = world.graph.edges()[e];
      edge.information = without_across(edge.information);
      if (std::max(edge.from, edge.to) == count) incremental.add_edge(edge);
    }
    from_scratch += incremental.update().from_scratch ? 1 : 0;
  }
  CHECK(from_scratch < 5);  // the first among them
  CHECK(all_planar(incremental.graph().poses()));
  CHECK(graph_cost(incremental.graph()) == Approx(optimize(world.graph).cost).epsilon(1e-2));
}

TEST_CASE("planar: false closures are found", "[optimization][planar][gnc]") {
  const auto seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  World world = grid_world(200, 60, seed);
  const GncResult result = optimize_gnc(world.graph);
  CHECK(all_planar(result.optimization.poses));
  const double c2 = chi_squared_quantile(GncOptions().inlier_probability, 3);
  world.solver.solve();
  std::size_t closures = 0, lost = 0;
  for (std::size_t e = 0; e < world.is_false.size(); ++e) {
    if (world.graph.edges()[e].kind == EdgeKind::kOdometry) continue;
    if (world.is_false[e]) {
      CHECK(result.weights[e] < 0.5);
      continue;
    }
    ++closures;
    lost += result.weights[e] < 0.5 ? 1 : 0;
    // What is lost lies beyond the threshold of three degrees of freedom, which one true closure in a hundred
    // does.
    const Edge& edge = world.graph.edges()[e];
    const Vector6d r =
        edge_residual(edge, result.optimization.poses[edge.from], result.optimization.poses[edge.to]);
    CHECK((result.weights[e] > 0.5) == (r.dot(edge.information * r) <= c2));
  }
  REQUIRE(closures > 20);
  CHECK(lost <= 1 + closures / 25);
  if (lost == 0) CHECK(worst_difference(result.optimization.poses, world.solver.poses) < 1e-7);
}

TEST_CASE("planar: a closure is judged by three degrees of freedom", "[optimization][planar][gnc]") {
  // Between the thresholds of 3 (11.3) and of 6 (16.8): an error that six would explain.
  PoseGraph graph;
  const bool is_planar = GENERATE(true, false);
  CAPTURE(is_planar);
  graph.set_planar(is_planar);
  for (Key key = 0; key < 2; ++key) {
    Node node;
    node.key = key;
    node.pose = planar::pose(static_cast<double>(key), 0.0, 0.0);
    graph.add_node(node);
    graph.add_prior(testing::prior_at(key, node.pose));
  }
  Edge edge;
  edge.from = 0;
  edge.to = 1;
  edge.T_from_to = planar::pose(1.0, std::sqrt(14.0), 0.0);
  graph.add_edge(edge);
  const GncResult result = optimize_gnc(graph);
  CHECK(result.inliers == (is_planar ? 0u : 1u));
}

TEST_CASE("planar: pairwise consistency finds the same as in space at its own threshold",
          "[optimization][planar]") {
  const World world = grid_world(150, 40, 2);
  const PcmResult result = pairwise_consistent(world.graph);
  std::size_t kept_false = 0, kept = 0;
  for (std::size_t e = 0; e < world.is_false.size(); ++e) {
    if (world.graph.edges()[e].kind == EdgeKind::kOdometry) continue;
    kept += result.kept[e] ? 1 : 0;
    kept_false += result.kept[e] && world.is_false[e] ? 1 : 0;
  }
  CHECK(kept > 10);
  CHECK(kept_false == 0);
}

TEST_CASE("planar: two closures agree by three degrees of freedom", "[optimization][planar]") {
  // They differ by a squared 14: between the thresholds of 3 (11.3) and of 6 (16.8).
  const bool is_planar = GENERATE(true, false);
  CAPTURE(is_planar);
  PoseGraph graph;
  graph.set_planar(is_planar);
  const auto join = [&](Key from, Key to, double y, double information, EdgeKind kind) {
    Edge edge;
    edge.from = from;
    edge.to = to;
    edge.T_from_to = planar::pose(0.0, y, 0.0);
    edge.information = planar::information(Eigen::Vector3d(information, information, 1e8).asDiagonal());
    edge.kind = kind;
    graph.add_edge(edge);
  };
  for (const Key key : {0u, 1u, 10u, 11u}) {
    Node node;
    node.key = key;
    graph.add_node(node);
  }
  join(0, 1, 0.0, 1e8, EdgeKind::kOdometry);
  join(10, 11, 0.0, 1e8, EdgeKind::kOdometry);
  join(0, 10, 0.0, 1.0, EdgeKind::kLoopClosure);
  join(1, 11, std::sqrt(2.0 * 14.0), 1.0, EdgeKind::kLoopClosure);
  CHECK(pairwise_consistent(graph).inliers == (is_planar ? 1u : 2u));
}

TEST_CASE("planar: certificates stay in the plane, where lower poses are found too",
          "[optimization][planar][certificate]") {
  // A ring of equal headings, which are wound around it once.
  constexpr int kCount = 30;
  PoseGraph wound;
  wound.set_planar();
  for (int i = 0; i < kCount; ++i) {
    Node node;
    node.key = static_cast<Key>(i);
    node.pose = planar::pose(0.0, 0.0, 6.283185307179586 * i / kCount);
    wound.add_node(node);
  }
  for (int i = 0; i < kCount; ++i) {
    const double angle = 6.283185307179586 * i / kCount;
    Edge edge;
    edge.from = static_cast<Key>(i);
    edge.to = static_cast<Key>((i + 1) % kCount);
    edge.T_from_to = planar::pose(std::cos(angle), std::sin(angle), 0.0);
    edge.information = planar::information(Eigen::Vector3d(1, 1, 100).asDiagonal());
    wound.add_edge(edge);
  }
  OptimizerOptions from_file;
  from_file.initialization = Initialization::kFile;
  wound.set_poses(optimize(wound, from_file).poses);
  REQUIRE(graph_cost(wound) > 1.0);
  const Certificate c = certify(wound);
  CAPTURE(c.message);
  REQUIRE(c.status == CertificateStatus::kImprovable);
  REQUIRE(all_planar(c.poses));
  REQUIRE(all_planar(c.best_poses));
  PoseGraph better = wound;
  better.set_poses(c.best_poses);
  REQUIRE(certify(better).status == CertificateStatus::kCertified);
  REQUIRE(certify(better).cost_at_estimate == Approx(c.best_cost).margin(1e-20));
  const CertifiedEstimate found = optimize_certified(wound);
  REQUIRE(found.improved);
  REQUIRE(found.cost < 1e-9);
  REQUIRE(found.certificate.status == CertificateStatus::kCertified);
  REQUIRE(all_planar(found.poses));
}

TEST_CASE("planar: certificates use the information within the plane",
          "[optimization][planar][certificate]") {
  PoseGraph graph;
  graph.set_planar();
  for (Key key = 0; key < 2; ++key) {
    Node node;
    node.key = key;
    node.pose = planar::pose(static_cast<double>(key), 0.3, 0.2 * static_cast<double>(key));
    graph.add_node(node);
  }
  Edge edge;
  edge.to = 1;
  edge.T_from_to = planar::pose(1.5, 0.1, -0.1);
  edge.information = Matrix6d::Zero();
  edge.information.diagonal() << 100, 400, 0, 0, 0, 900;
  graph.add_edge(edge);
  const double tau = 2.0 / (1.0 / 100 + 1.0 / 400), kappa = 450.0;
  const Eigen::Matrix4d error =
      graph.nodes()[1].pose.matrix() - graph.nodes()[0].pose.matrix() * edge.T_from_to.matrix();
  const Certificate c = certify(graph);
  REQUIRE(c.reduced_factors == 0);
  REQUIRE(c.status == CertificateStatus::kCertified);
  REQUIRE(c.cost_at_estimate == Approx(0.5 * (kappa * error.topLeftCorner<3, 3>().squaredNorm() +
                                              tau * error.col(3).squaredNorm())));
}

TEST_CASE("planar: covariances are those of two dimensions, and nothing elsewhere",
          "[optimization][planar][marginals][differential]") {
  const auto seed = GENERATE(range(1u, 4u));
  CAPTURE(seed);
  World world = grid_world(60, 0, seed);
  world.solver.solve();
  PoseGraph graph = world.graph;
  std::vector<Eigen::Isometry3d> poses;
  for (const Pose2& p : world.solver.poses) poses.push_back(lifted(p));
  graph.set_poses(poses);
  Eigen::VectorXd g;
  const Eigen::MatrixXd H = world.solver.hessian(g);
  const Eigen::MatrixXd S = H.inverse();
  const HessianFactor factor(graph);
  const Marginals known = factor.marginals();
  double translation = 0.0, full = 0.0, worst = 0.0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Eigen::Matrix3d block =
        S.block<3, 3>(static_cast<Eigen::Index>(3 * i), static_cast<Eigen::Index>(3 * i));
    const Matrix6d& m = known.covariances[i];
    worst = std::max(worst, (planar::block(m) - block).norm() / block.norm());
    CHECK(planar::is_information(m));
    CHECK(m.block<3, 3>(2, 2).isZero(0.0));
    translation += block(0, 0) + block(1, 1);
    full += block.trace();
  }
  CHECK(worst < 1e-5);  // measured: 6e-8, of the numerical Jacobians
  CHECK(known.trace_translation == Approx(translation).epsilon(1e-5));
  CHECK(known.trace_full == Approx(full).epsilon(1e-5));
  const Eigen::LLT<Eigen::MatrixXd> llt(H);
  const double log_determinant = 2.0 * Eigen::VectorXd(llt.matrixLLT().diagonal()).array().log().sum();
  CHECK(factor.log_determinant() == Approx(log_determinant).epsilon(1e-7));

  // Solves, joint covariances and updates see the same Σ.
  const Matrix12d joint = factor.joint({{5, 40}}).at(0);
  const Matrix6d cross = joint.block<6, 6>(0, 6);
  CHECK((planar::block(cross) - S.block<3, 3>(15, 120)).norm() < 1e-5 * S.block<3, 3>(15, 120).norm());
  CHECK(cross.middleRows<3>(2).isZero(0.0));
  CHECK(factor.columns(7).row(6 * 9 + 3).isZero(0.0));
  Edge edge;
  edge.from = 3;
  edge.to = 50;
  edge.T_from_to = poses[3].inverse() * poses[50];
  edge.information = planar::information(Eigen::Vector3d(100, 100, 1000).asDiagonal());
  const Marginals with = factor.marginals_with({edge}, known);
  graph.add_edge(edge);
  const Marginals again = marginals(graph);
  CHECK(with.trace_full == Approx(again.trace_full).epsilon(1e-9));
  CHECK(with.trace_full < known.trace_full);
}

TEST_CASE("planar: an undetermined pose is an error, as in 3D", "[optimization][planar][error]") {
  World world = grid_world(10, 0, 1);
  Node node;
  node.key = 100;
  world.graph.add_node(node);
  Edge edge;
  edge.from = 5;
  edge.to = 100;
  // A place without a heading.
  edge.information = planar::information(Eigen::Vector3d(100, 100, 0).asDiagonal());
  world.graph.add_edge(edge);
  CHECK_THROWS_WITH(marginals(world.graph), Contains("node 100: the factors do not determine its pose"));
  const OptimizationResult result = optimize(world.graph);
  CHECK(result.underdetermined);
  CHECK(all_planar(result.poses));
}

TEST_CASE("planar: the published 2D graphs stay in the plane", "[optimization][planar][data]") {
  const auto folder = testing::test_data("rrr");
  if (!folder) return;
  std::size_t files = 0;
  for (const auto& entry : testing::fs::directory_iterator(*folder)) {
    if (entry.path().extension() != ".g2o") continue;
    CAPTURE(entry.path().string());
    PoseGraph graph;
    graph.set_planar();
    std::ifstream in(entry.path());
    std::vector<Edge> edges;
    for (std::string line; std::getline(in, line);) {
      std::istringstream s(line);
      std::string tag;
      double x = 0, y = 0, theta = 0;
      s >> tag;
      if (tag == "VERTEX_SE2") {
        Node node;
        s >> node.key >> x >> y >> theta;
        node.pose = planar::pose(x, y, theta);
        graph.add_node(node);
      } else if (tag == "EDGE_SE2") {
        Edge edge;
        Eigen::Matrix3d m;
        s >> edge.from >> edge.to >> x >> y >> theta >> m(0, 0) >> m(0, 1) >> m(0, 2) >> m(1, 1) >> m(1, 2) >>
            m(2, 2);
        m.triangularView<Eigen::StrictlyLower>() = m.transpose();
        edge.T_from_to = planar::pose(x, y, theta);
        edge.information = planar::information(m);
        edge.kind = edge.to == edge.from + 1 ? EdgeKind::kOdometry : EdgeKind::kLoopClosure;
        if (edge.from != edge.to) edges.push_back(edge);
      }
    }
    for (const Edge& edge : edges) graph.add_edge(edge);
    if (graph.empty()) continue;
    ++files;
    graph.add_prior(testing::prior_at(graph.nodes()[0].key, graph.nodes()[0].pose));
    GncOptions options;
    options.second_start = false;
    const GncResult result = optimize_gnc(graph, {}, options);
    CHECK(result.optimization.converged);
    CHECK(all_planar(result.optimization.poses));
  }
  CHECK(files > 0);
}

}  // namespace loopwise::planar_test
