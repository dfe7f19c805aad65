// SPDX-License-Identifier: BSD-3-Clause
// Covariances of closures: what uncertain odometry within a submap adds, and how well they fit the errors.
#include <algorithm>
#include <cmath>
#include <iomanip>
#include <map>
#include <numeric>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/se3.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/task.hpp>
#ifdef LOOPWISE_WITH_PCL
#include <loopwise/registration/pcl_registrar.hpp>
#endif
#include "scene.hpp"
#include "testing.hpp"

namespace loopwise::covariances_test {
namespace {

/// Five scans, 2 m apart. Scan 4 is registered to a submap about scan 1.
struct Drive {
  testing::Scans scans;
  std::vector<Eigen::Isometry3d> poses;

  Drive() {
    const testing::Scene scene(11);
    Rng rng(12);
    for (int i = 0; i < 5; ++i) {
      poses.push_back(testing::ground_pose(2.0 * i - 5.0, 0.5 * i, 0.4 * i));
      scans[static_cast<Key>(i)] = scene.scan(poses.back(), 6000, rng, 0.02, 20.0);
    }
  }
  /// The members before or after scan 1 are moved by `moved` in its frame, with this covariance.
  [[nodiscard]] RegistrationTask task(bool after, const Eigen::Isometry3d& moved,
                                      const Matrix6d& covariance) const {
    RegistrationTask task = pair_task(4, 1, 3);
    for (const Key key : {0, 2, 3}) {
      const Eigen::Isometry3d T = poses[1].inverse() * poses[key];
      const bool beyond = (key > 1) == after;
      task.target.push_back({key, beyond ? moved * T : T, beyond ? covariance : Matrix6d::Zero()});
    }
    return task;
  }
};

std::unique_ptr<Registrar> make_registrar(const std::string& name, const testing::Scans& scans) {
  const auto features = std::make_shared<FeatureCache>(testing::loader(scans));
#ifdef LOOPWISE_WITH_PCL
  if (name == "pcl") return std::make_unique<PclRegistrar>(features);
#endif
  return std::make_unique<FastRegistrar>(features);
}

/// Squared Mahalanobis length.
double squared(const Vector6d& error, const Matrix6d& covariance) {
  return error.dot(covariance.ldlt().solve(error));
}

/// Mean over the six degrees of freedom: 1 for perfect covariances.
double mean_of(const std::vector<double>& squared) {
  return std::accumulate(squared.begin(), squared.end(), 0.0) / (6.0 * static_cast<double>(squared.size()));
}

/// Share beyond the 95 % point of χ² with six degrees of freedom.
double share_beyond(const std::vector<double>& squared) {
  const auto beyond = std::count_if(squared.begin(), squared.end(), [](double d) { return d > 12.59; });
  return static_cast<double>(beyond) / static_cast<double>(squared.size());
}

}  // namespace

TEST_CASE("submap errors: a closure's covariance follows what a moved member does to it", "[registrar]") {
  const Drive drive;
  const bool after = GENERATE(false, true);
#ifdef LOOPWISE_WITH_PCL
  const std::string name = GENERATE(as<std::string>(), "fast", "pcl");
#else
  const std::string name = "fast";
#endif
  CAPTURE(after, name);
  const double part = name == "fast" ? 0.05 : 0.15;  // PCL refines with other matches
  const auto registrar = make_registrar(name, drive.scans);
  const auto compute = [&](const Eigen::Isometry3d& moved, const Matrix6d& covariance) {
    const RegistrationResult result = registrar->compute(drive.task(after, moved, covariance));
    CAPTURE(result.message);
    REQUIRE(result.verified());
    return *result.closure;
  };
  const Eigen::Isometry3d still = Eigen::Isometry3d::Identity();
  const LoopClosure certain = compute(still, Matrix6d::Zero());
  for (Eigen::Index axis = 0; axis < 6; ++axis) {
    CAPTURE(axis);
    Vector6d step = Vector6d::Zero();
    step[axis] = axis < 3 ? 0.03 : 0.004;
    const LoopClosure uncertain = compute(still, step * step.transpose());
    REQUIRE(uncertain.T_from_to.matrix() == certain.T_from_to.matrix());
    const Matrix6d added = uncertain.covariance - certain.covariance;
    const Vector6d follows =
        se3::log(certain.T_from_to.inverse() * compute(se3::exp(step), Matrix6d::Zero()).T_from_to);
    const double said = std::sqrt(std::max(0.0, added(axis, axis)));
    CAPTURE(said, follows[axis], step[axis]);
    REQUIRE(said > 0.05 * step[axis]);
    REQUIRE(std::abs(said - std::abs(follows[axis])) < part * step[axis] + 0.3 * std::abs(follows[axis]));
  }
}

TEST_CASE("submap errors: members of one side share the steps of the nearer ones", "[registrar]") {
  const Drive drive;
  const FastRegistrar registrar(std::make_shared<FeatureCache>(testing::loader(drive.scans)));
  const Matrix6d step = 1e-4 * Matrix6d::Identity();
  const auto added = [&](const Matrix6d& near, const Matrix6d& far) {
    RegistrationTask task = drive.task(true, Eigen::Isometry3d::Identity(), Matrix6d::Zero());
    const Matrix6d before = registrar.compute(task).closure->covariance;
    task.target[2].covariance = near;
    task.target[3].covariance = far;
    return Matrix6d(registrar.compute(task).closure->covariance - before);
  };
  const Matrix6d zero = Matrix6d::Zero();
  // A step before both members and one between them are independent.
  const Matrix6d both = added(step, 2.0 * step), common = added(step, step), last = added(zero, step);
  REQUIRE((both - common - last).norm() < 1e-9 * both.norm());
  REQUIRE(common.trace() > last.trace());
}

TEST_CASE("covariances: errors in generated yards are within those that closures state", "[registrar]") {
  std::vector<double> all;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const testing::Scene scene(seed);
    Rng rng(seed + 100);
    testing::Scans scans;
    std::vector<Eigen::Isometry3d> poses;
    for (int i = 0; i < 4; ++i) {
      poses.push_back(testing::ground_pose(3.0 * i - 5.0, 0.5 * i, 0.7 * i));
      scans[static_cast<Key>(i)] = scene.scan(poses.back(), 6000, rng, 0.03, 20.0);
    }
    const FastRegistrar registrar(std::make_shared<FeatureCache>(testing::loader(scans)));
    for (Key from = 1; from < 4; ++from) {
      for (Key to = 0; to < from; ++to) {
        const RegistrationResult result = registrar.compute(pair_task(from, to, 1));
        if (!result.verified()) continue;
        const Eigen::Isometry3d truth = poses[from].inverse() * poses[to];
        all.push_back(
            squared(se3::log(result.closure->T_from_to.inverse() * truth), result.closure->covariance));
      }
    }
  }
  CAPTURE(all.size(), mean_of(all));
  REQUIRE(all.size() >= 30);
  REQUIRE(mean_of(all) > 0.05);
  REQUIRE(mean_of(all) < 1.3);
  REQUIRE(share_beyond(all) <= 0.05);
}

TEST_CASE("covariances: closures of real scans contradict each other no more than they state",
          "[registrar][data]") {
  const auto folder = testing::test_data("kaist03");
  if (!folder) return;
  const FastRegistrar registrar(std::make_shared<FeatureCache>([&](Key key) {
    std::ostringstream file;
    file << std::setw(6) << std::setfill('0') << key << ".pcd";
    return std::make_shared<const PointCloud>(read_cloud(*folder / "Scans" / file.str()).cloud);
  }));
  constexpr Key kScans = 9;
  std::map<std::pair<Key, Key>, LoopClosure> closures;
  for (Key from = 0; from < kScans; ++from) {
    for (Key to = from + 1; to < kScans; ++to) {
      const RegistrationResult result = registrar.compute(pair_task(from, to, 1));
      if (result.verified()) closures.emplace(std::pair(from, to), *result.closure);
    }
  }
  // Around a triangle, the poses multiply to the identity.
  std::vector<double> all;
  for (const auto& [ab, first] : closures) {
    for (const auto& [bc, second] : closures) {
      if (ab.second != bc.first) continue;
      const auto direct = closures.find({ab.first, bc.second});
      if (direct == closures.end()) continue;
      const Matrix6d ad = se3::adjoint(second.T_from_to.inverse());
      const Vector6d error =
          se3::log(direct->second.T_from_to.inverse() * first.T_from_to * second.T_from_to);
      all.push_back(squared(
          error, ad * first.covariance * ad.transpose() + second.covariance + direct->second.covariance));
    }
  }
  CAPTURE(closures.size(), all.size(), mean_of(all));
  REQUIRE(all.size() >= 60);
  REQUIRE(mean_of(all) > 0.1);
  REQUIRE(mean_of(all) < 1.3);
  REQUIRE(share_beyond(all) <= 0.05);
}

TEST_CASE("make_task: covariances of neighbours are those of their poses by odometry", "[task]") {
  Rng rng(8);
  std::vector<Eigen::Isometry3d> steps;
  for (int i = 0; i < 4; ++i) steps.push_back(testing::random_pose(rng, 2.0));
  const Robots robots = Robots::from_keys({0, 1, 2, 3, 4, 9});
  const auto task = [&](const std::vector<Eigen::Isometry3d>& of) {
    PoseGraph graph;
    for (const Key key : {0, 1, 2, 3, 4, 9}) {
      Node node;
      node.key = key;
      graph.add_node(node);
    }
    for (Key k = 0; k < 4; ++k) {
      Edge edge{k, k + 1, of[k], Matrix6d::Identity()};
      if (k == 2) {  // against the direction of the path
        edge = {k + 1, k, of[k].inverse(), Matrix6d::Identity()};
      }
      edge.kind = EdgeKind::kOdometry;
      graph.add_edge(edge);
    }
    LoopCandidate candidate;
    candidate.from = 9;
    candidate.to = 2;
    return make_task(graph, robots, candidate, {}, 1);
  };
  const RegistrationTask base = task(steps);
  REQUIRE(base.target.size() == 5);
  std::vector<Matrix6d> expected(5, Matrix6d::Zero());
  constexpr double kSmall = 1e-6;
  for (std::size_t k = 0; k < 4; ++k) {
    for (Eigen::Index axis = 0; axis < 6; ++axis) {
      std::vector<Eigen::Isometry3d> moved = steps;
      const Eigen::Isometry3d error = se3::exp(kSmall * Vector6d::Unit(axis));
      // The error is on the right of the measured transform, which is inverted for k = 2.
      moved[k] = k == 2 ? (moved[k].inverse() * error).inverse() : moved[k] * error;
      const RegistrationTask other = task(moved);
      for (std::size_t m = 0; m < 5; ++m) {
        const Vector6d off =
            se3::log(other.target[m].T_center_member * base.target[m].T_center_member.inverse()) / kSmall;
        expected[m] += off * off.transpose();
      }
    }
  }
  for (std::size_t m = 0; m < 5; ++m) {
    CAPTURE(m);
    REQUIRE((base.target[m].covariance - expected[m]).norm() <= 1e-4 * (1.0 + expected[m].norm()));
  }
}

}  // namespace loopwise::covariances_test
