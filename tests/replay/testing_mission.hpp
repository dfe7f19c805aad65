// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A small mission in memory, and a registrar that knows the truth: what tests of replays and of the module
/// run on.
#pragma once

#include <cmath>
#include <map>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/registration/registrar.hpp>

#include "testing.hpp"

namespace loopwise::testing {

/// The measurement of an edge, as a front end hands it over.
inline BetweenFactor between(const Edge& edge) {
  return {edge.from, edge.to, edge.T_from_to, edge.information, edge.trusted};
}

inline Factors factors(std::vector<BetweenFactor> odometry, std::vector<PriorFactor> priors = {}) {
  Factors factors;
  factors.odometry = std::move(odometry);
  factors.priors = std::move(priors);
  return factors;
}

/// For ModuleParts::registrar.
inline auto given(std::shared_ptr<const Registrar> registrar) {
  return [registrar = std::move(registrar)](const ScanLoader&) { return registrar; };
}

/// Two robots drive circles of 20 m radius that start side by side, a node every 2 m and 2 s. The odometry
/// drifts; each robot's first node has a prior. Scans are a few points, distinct for each node.
inline Mission two_circles(std::uint64_t seed = 1, std::size_t nodes_per_robot = 40) {
  Mission mission;
  mission.name = "two circles";
  mission.robots = parse_robots("a,b");
  Rng rng(seed);
  std::vector<Key> keys;
  for (const char character : {'a', 'b'}) {
    Eigen::Isometry3d truth = Eigen::Isometry3d::Identity(), drifted = truth;
    truth.translation().y() = drifted.translation().y() = character == 'a' ? 0.0 : 4.0;
    Eigen::Isometry3d step = Eigen::Isometry3d::Identity();
    step.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 0.1));
    step.translation().x() = 2.0;
    for (std::uint64_t i = 0; i < nodes_per_robot; ++i) {
      const Key key = make_key(character, i);
      Edge edge;
      if (i > 0) {
        Vector6d noise;
        for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0.0, k < 3 ? 0.05 : 0.01);
        edge.from = key - 1;
        edge.to = key;
        edge.kind = EdgeKind::kOdometry;
        edge.T_from_to = step * se3::exp(noise);
        edge.information.diagonal() << Eigen::Vector3d::Constant(400.0), Eigen::Vector3d::Constant(1e4);
        truth = truth * step;
        drifted = se3::normalized(drifted * edge.T_from_to);
      }
      Node node;
      node.key = key;
      node.pose = drifted;
      node.stamp_ns = static_cast<std::int64_t>(i) * 2000000000 + (character == 'a' ? 0 : 500000000);
      mission.graph.add_node(node);
      if (i > 0) {
        mission.graph.add_edge(edge);
      } else {
        PriorFactor prior;
        prior.key = key;
        prior.pose = node.pose;
        prior.information = 1e6 * Matrix6d::Identity();
        mission.graph.add_prior(prior);
      }
      mission.ground_truth[key] = truth;
      keys.push_back(key);
    }
  }
  mission.scans = std::make_shared<ScanStore>(keys, [](Key key) {
    auto cloud = std::make_shared<PointCloud>();
    Rng points(key);
    for (int i = 0; i < 60; ++i) {
      cloud->points.emplace_back(static_cast<float>(points.uniform(-5.0, 5.0)),
                                 static_cast<float>(points.uniform(-5.0, 5.0)),
                                 static_cast<float>(points.uniform(-2.0, 2.0)));
    }
    return cloud;
  });
  return mission;
}

/// Adds a landmark "L0" that robot a sees at the start and the end of its path and robot b in the middle, a
/// range between the robots' last nodes, and gravity at every fourth node: all as the truth has them.
inline Mission with_landmark(Mission mission) {
  std::vector<Robot> robots = mission.robots.all();
  robots.push_back(robot_of_character('L', "artifacts"));
  robots.back().landmarks = true;
  mission.robots = Robots(std::move(robots));
  const std::uint64_t last = mission.graph.nodes().size() / 2 - 1;
  Node landmark;
  landmark.key = make_key('L', 0);
  landmark.pose.translation() = Eigen::Vector3d(3.0, -6.0, 1.0);
  landmark.stamp_ns = mission.graph.nodes().front().stamp_ns;
  const Eigen::Isometry3d truth = landmark.pose;
  landmark.pose.translation().x() += 1.0;
  mission.graph.add_node(landmark);
  for (const Key seen_from : {make_key('a', 0), make_key('b', last / 2), make_key('a', last)}) {
    Edge edge{seen_from, landmark.key, mission.ground_truth.at(seen_from).inverse() * truth,
              1e4 * Matrix6d::Identity()};
    edge.kind = EdgeKind::kLandmark;
    mission.graph.add_edge(edge);
  }
  const Key a = make_key('a', last), b = make_key('b', last);
  mission.graph.add_range(
      {a, b, (mission.ground_truth.at(a).translation() - mission.ground_truth.at(b).translation()).norm(),
       0.05});
  for (const auto& [key, pose] : mission.ground_truth) {
    if (key % 4 != 0) continue;
    GravityFactor gravity;
    gravity.key = key;
    gravity.direction = -pose.linear().transpose() * Eigen::Vector3d::UnitZ();
    gravity.sigma_rad = 0.01;
    mission.graph.add_gravity(gravity);
  }
  return mission;
}

/// Gives the true relative pose with a little noise, a wrong one for a seeded share of the pairs, and rejects
/// another share. The outcome of a pair depends on its task alone.
class OracleRegistrar final : public Registrar {
 public:
  OracleRegistrar(std::map<Key, Eigen::Isometry3d> truth, double false_share = 0.1,
                  double rejected_share = 0.3)
      : truth_(std::move(truth)), false_share_(false_share), rejected_share_(rejected_share) {}

  [[nodiscard]] std::string_view name() const override { return "oracle"; }

  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    Rng rng(task.seed);
    RegistrationResult result;
    result.candidate = task.candidate;
    const double draw = rng.uniform();
    if (draw < rejected_share_) {
      result.reason = RejectionReason::kGicpFitness;
      result.message = "drawn";
      return result;
    }
    Vector6d noise;
    for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0.0, k < 3 ? 0.02 : 0.002);
    if (draw < rejected_share_ + false_share_) noise.head<3>() += Eigen::Vector3d(3.0, -2.0, 1.0);
    LoopClosure closure;
    closure.from = task.candidate.from;
    closure.to = task.candidate.to;
    closure.T_from_to = truth_.at(closure.from).inverse() * truth_.at(closure.to) * se3::exp(noise);
    closure.covariance.setZero();
    closure.covariance.diagonal() << Eigen::Vector3d::Constant(4e-4), Eigen::Vector3d::Constant(4e-6);
    result.T_from_to = closure.T_from_to;
    result.closure = closure;
    result.gicp_fitness_m2 = 0.01;
    result.overlap = 0.9;
    return result;
  }

 private:
  std::map<Key, Eigen::Isometry3d> truth_;
  double false_share_, rejected_share_;
};

}  // namespace loopwise::testing
