// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Pose graphs for the tests of optimisation: random ones, and a small independent g2o reader.
#pragma once

#include <Eigen/Dense>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "testing.hpp"

namespace loopwise::testing {

/// Symmetric positive definite, condition number up to about 100.
inline Matrix6d random_information(Rng& rng, double scale = 1.0) {
  Matrix6d a;
  for (int i = 0; i < 36; ++i) a(i / 6, i % 6) = rng.normal();
  return scale * (a * a.transpose() + Matrix6d::Identity());
}

inline PriorFactor prior_at(Key key, const Eigen::Isometry3d& pose, double sigma = 1e-4) {
  PriorFactor prior;
  prior.key = key;
  prior.pose = pose;
  prior.information = Matrix6d::Identity() / (sigma * sigma);
  return prior;
}

struct RandomGraph {
  PoseGraph graph;                       ///< Poses are the noisy odometry's.
  std::vector<Eigen::Isometry3d> truth;  ///< By node.
  std::vector<bool> is_false;            ///< By edge.
};

struct RandomGraphOptions {
  std::size_t nodes = 30;
  std::size_t closures = 15;
  std::size_t false_closures = 0;
  double sigma_m = 0.02;
  double sigma_rad = 0.01;
  bool prior = true;
};

/// A walk with odometry and random closures, noise as the information says; false closures are random poses.
inline RandomGraph random_graph(Rng& rng, const RandomGraphOptions& options = {}) {
  RandomGraph out;
  Vector6d sigmas;
  sigmas << Eigen::Vector3d::Constant(options.sigma_m), Eigen::Vector3d::Constant(options.sigma_rad);
  const Matrix6d information = sigmas.cwiseAbs2().cwiseInverse().asDiagonal();
  const auto noise = [&] {
    Vector6d xi;
    for (int i = 0; i < 6; ++i) xi[i] = sigmas[i] * rng.normal();
    return se3::exp(xi);
  };
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity(), drifted = pose;
  std::vector<Edge> edges;
  for (std::size_t i = 0; i < options.nodes; ++i) {
    if (i > 0) {
      Eigen::Isometry3d step = random_pose(rng, 0.1, 0.6);
      step.translation().x() += 1.0;
      Edge edge;
      edge.from = i - 1;
      edge.to = i;
      edge.T_from_to = step * noise();
      edge.information = information;
      edge.kind = EdgeKind::kOdometry;
      edges.push_back(edge);
      pose = pose * step;
      drifted = drifted * edge.T_from_to;
    }
    Node node;
    node.key = i;
    node.pose = se3::normalized(drifted);
    out.graph.add_node(node);
    out.truth.push_back(pose);
  }
  out.is_false.assign(edges.size(), false);
  const auto add = [&](bool is_false) {
    const std::size_t a = rng.below(options.nodes);
    std::size_t b = rng.below(options.nodes);
    while (b == a || b == a + 1 || a == b + 1) b = rng.below(options.nodes);
    Edge edge;
    edge.from = a;
    edge.to = b;
    edge.T_from_to = is_false ? random_pose(rng, 5.0) : out.truth[a].inverse() * out.truth[b] * noise();
    edge.information = information;
    edges.push_back(edge);
    out.is_false.push_back(is_false);
  };
  for (std::size_t i = 0; i < options.closures; ++i) add(false);
  for (std::size_t i = 0; i < options.false_closures; ++i) add(true);
  for (const Edge& edge : edges) out.graph.add_edge(edge);
  if (options.prior) out.graph.add_prior(prior_at(0, Eigen::Isometry3d::Identity()));
  return out;
}

/// Ranges between nodes, and gravity at every third: free of noise.
inline void add_auxiliary_factors(RandomGraph& random, Rng& rng) {
  const std::size_t n = random.truth.size();
  for (int i = 0; i < 12; ++i) {
    const std::size_t a = rng.below(n), b = (a + 1 + rng.below(n - 1)) % n;
    random.graph.add_range(
        {a, b, (random.truth[a].translation() - random.truth[b].translation()).norm(), 0.1});
  }
  for (std::size_t i = 0; i < n; i += 3) {
    GravityFactor gravity;
    gravity.key = i;
    gravity.direction = -random.truth[i].linear().transpose() * Eigen::Vector3d::UnitZ();
    gravity.sigma_rad = 0.02;
    random.graph.add_gravity(gravity);
  }
}

/// Plain reader of the shared 3D g2o files; consecutive ids are odometry.
inline PoseGraph read_graph(const fs::path& path, const std::vector<Key>& priors) {
  PoseGraph graph;
  std::ifstream in(path);
  std::vector<Edge> edges;
  const auto pose = [](std::istream& s) {
    double x, y, z, qx, qy, qz, qw;
    s >> x >> y >> z >> qx >> qy >> qz >> qw;
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = Eigen::Quaterniond(qw, qx, qy, qz).normalized().toRotationMatrix();
    T.translation() << x, y, z;
    return T;
  };
  for (std::string line; std::getline(in, line);) {
    std::istringstream s(line);
    std::string tag;
    s >> tag;
    if (tag == "VERTEX_SE3:QUAT") {
      Node node;
      s >> node.key;
      node.pose = pose(s);
      graph.add_node(node);
    } else if (tag == "EDGE_SE3:QUAT") {
      Edge edge;
      s >> edge.from >> edge.to;
      edge.T_from_to = pose(s);
      for (int r = 0; r < 6; ++r) {
        for (int c = r; c < 6; ++c) {
          s >> edge.information(r, c);
          edge.information(c, r) = edge.information(r, c);
        }
      }
      edge.kind = edge.to == edge.from + 1 ? EdgeKind::kOdometry : EdgeKind::kLoopClosure;
      edges.push_back(edge);
    }
  }
  for (const Edge& edge : edges) graph.add_edge(edge);
  for (const Key key : priors) graph.add_prior(prior_at(key, graph.node(key).pose));
  return graph;
}

/// A graph's Hessian Σ w JᵀΩJ over all nodes from numerical Jacobians of the residuals, dense.
inline Eigen::MatrixXd dense_hessian(const PoseGraph& graph, Eigen::VectorXd* gradient = nullptr) {
  const auto n = static_cast<Eigen::Index>(6 * graph.nodes().size());
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
  const auto add = [&](const Eigen::Isometry3d& Z, const Matrix6d& information, std::ptrdiff_t from,
                       std::size_t to) {
    const Eigen::Isometry3d from_pose =
        from < 0 ? Eigen::Isometry3d::Identity() : graph.nodes()[static_cast<std::size_t>(from)].pose;
    const Eigen::Isometry3d to_pose = graph.nodes()[to].pose;
    const auto residual = [&](const Vector6d& a, const Vector6d& b) -> Vector6d {
      return se3::log(Z.inverse() * (from_pose * se3::exp(a)).inverse() * (to_pose * se3::exp(b)));
    };
    Eigen::Matrix<double, 6, 12> J;
    const double h = 1e-5;
    for (int k = 0; k < 6; ++k) {
      const Vector6d d = h * Vector6d::Unit(k), zero = Vector6d::Zero();
      J.col(k) = (residual(d, zero) - residual(-d, zero)) / (2.0 * h);
      J.col(6 + k) = (residual(zero, d) - residual(zero, -d)) / (2.0 * h);
    }
    const Vector6d r = residual(Vector6d::Zero(), Vector6d::Zero());
    const Eigen::Index at[2] = {6 * from, 6 * static_cast<Eigen::Index>(to)};
    for (int a = from < 0 ? 1 : 0; a < 2; ++a) {
      g.segment<6>(at[a]) += J.middleCols<6>(6 * a).transpose() * information * r;
      for (int b = from < 0 ? 1 : 0; b < 2; ++b) {
        H.block<6, 6>(at[a], at[b]) +=
            J.middleCols<6>(6 * a).transpose() * information * J.middleCols<6>(6 * b);
      }
    }
  };
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    add(edge.T_from_to, edge.weight * edge.information, static_cast<std::ptrdiff_t>(graph.ends(e).from),
        graph.ends(e).to);
  }
  for (const PriorFactor& prior : graph.priors())
    add(prior.pose, prior.information, -1, graph.index_of(prior.key));
  if (gradient != nullptr) *gradient = g;
  return H;
}

}  // namespace loopwise::testing
