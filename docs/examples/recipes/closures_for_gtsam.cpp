// SPDX-License-Identifier: BSD-3-Clause
// Closures for a back end by GTSAM. The types below have GTSAM's conventions, so that this builds without it.
// With GTSAM, this line adds a closure:
//
//   graph.emplace_shared<gtsam::BetweenFactor<gtsam::Pose3>>(
//       closure.from, closure.to, gtsam::Pose3(closure.T_from_to.matrix()),
//       gtsam::noiseModel::Gaussian::Covariance(loopwise::se3::swap_tangent_order(closure.covariance)));
#include <cmath>
#include <cstdio>

#include <loopwise/core/error.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/fast_registrar.hpp>

namespace like_gtsam {

using Key = std::uint64_t;  // a Symbol's character and index, as loopwise::Key

/// As gtsam::BetweenFactor<gtsam::Pose3> with a Gaussian noise model: tangent order rotation before
/// translation.
struct BetweenFactor {
  Key key1, key2;
  Eigen::Isometry3d measured;
  Eigen::Matrix<double, 6, 6> covariance;

  /// ½ rᵀΣ⁻¹r, r = Logmap(measured⁻¹ · x1⁻¹ · x2).
  [[nodiscard]] double error(const Eigen::Isometry3d& x1, const Eigen::Isometry3d& x2) const {
    const loopwise::Vector6d xi = loopwise::se3::log(measured.inverse() * x1.inverse() * x2);
    Eigen::Matrix<double, 6, 1> r;
    r << xi.tail<3>(), xi.head<3>();
    return 0.5 * r.dot(covariance.ldlt().solve(r));
  }
};

}  // namespace like_gtsam

using namespace loopwise;

/// Keys and pose stay the same; the covariance changes its order.
like_gtsam::BetweenFactor to_factor(const LoopClosure& closure) {
  return {closure.from, closure.to, closure.T_from_to, se3::swap_tangent_order(closure.covariance)};
}

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: closures_for_gtsam MISSION\n");
    return 2;
  }
  try {
    const Mission mission = read_mission(argv[1]);
    if (mission.robots.size() < 2) throw InputError("the example needs a mission of two robots");
    std::vector<RegistrationTask> tasks;  // the first nodes of two robots, which left the same gate
    for (std::uint64_t i = 0; i < 10; ++i) {
      tasks.push_back(pair_task(mission.robots[1].first + i, mission.robots[0].first + i, /*seed=*/1));
    }
    const FastRegistrar registrar(std::make_shared<FeatureCache>(mission.scans->loader()));
    ThreadPool threads;
    std::size_t factors = 0;
    double largest_difference = 0.0;
    for (const auto& result : compute_batch(registrar, tasks, threads)) {
      if (!result->verified()) continue;
      const LoopClosure& closure = *result->closure;
      const like_gtsam::BetweenFactor factor = to_factor(closure);
      ++factors;
      // Both back ends must compute the same cost for it.
      const Eigen::Isometry3d &x1 = mission.graph.node(closure.from).pose,
                              &x2 = mission.graph.node(closure.to).pose;
      const Vector6d r = edge_residual({closure.from, closure.to, closure.T_from_to}, x1, x2);
      const double ours = 0.5 * r.dot(closure.covariance.ldlt().solve(r));
      largest_difference = std::max(largest_difference, std::abs(factor.error(x1, x2) - ours) / (1.0 + ours));
    }
    std::printf("%zu factors; costs differ by %.1e at most\n", factors, largest_difference);
    return factors > 0 && largest_difference < 1e-9 ? 0 : 1;
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
