// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A whole mission of real scans, end to end: the result is compared with the poses in the session.
#include <algorithm>
#include <cmath>

#include <loopwise/replay/replay.hpp>

#include "testing.hpp"

namespace loopwise::session_test {
namespace {

constexpr double kDegrees = 57.29577951308232;

struct ClosureErrors {
  std::vector<double> m, deg;
  void add(const LoopClosure& closure, const std::map<Key, Eigen::Isometry3d>& truth) {
    const Eigen::Isometry3d T = truth.at(closure.from).inverse() * truth.at(closure.to);
    const Eigen::Isometry3d error = T.inverse() * closure.T_from_to;
    m.push_back(error.translation().norm());
    deg.push_back(se3::rotation_angle(error) * kDegrees);
  }
};

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

ReplayOptions session_config() {
  ReplayOptions config;
  config.engine.generation.skip_recent = 2;
  config.prioritization.method = parse_method("obs");
  config.after_mission = true;
  return config;
}

ReplayResult replay_session(const Mission& mission, const ReplayOptions& config) {
  return replay(mission, config, {}, 2);
}

/// Mean distance of the positions after the best rigid motion.
double aligned_error(const std::vector<Eigen::Isometry3d>& poses, const Mission& mission,
                     const PoseGraph& graph) {
  Eigen::Matrix3Xd estimate(3, poses.size()), truth(3, poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    estimate.col(static_cast<Eigen::Index>(i)) = poses[i].translation();
    truth.col(static_cast<Eigen::Index>(i)) = mission.reference.at(graph.nodes()[i].key).translation();
  }
  const Eigen::Matrix4d S = Eigen::umeyama(estimate, truth, false);
  return ((S.topLeftCorner<3, 3>() * estimate).colwise() + S.topRightCorner<3, 1>().eval() - truth)
      .colwise()
      .norm()
      .mean();
}

}  // namespace

TEST_CASE("session: closures of real scans agree with the session's poses", "[replay][data]") {
  const auto path = testing::test_data("kaist03");
  if (!path) return;
  const Mission mission = read_mission(*path);
  for (const RegistrarKind kind : {RegistrarKind::kFast, RegistrarKind::kPcl}) {
    CAPTURE(enum_name(kind));
    ReplayOptions config = session_config();
    config.registration.registrar = kind;
    // Every third of PCL's pairs will do; it takes several times as long.
    if (kind == RegistrarKind::kPcl) config.max_registrations = 60;
    const ReplayResult result = replay_session(mission, config);
    ClosureErrors near, all;
    double worst_inlier_m = 0.0;
    for (const ComputedCandidate& computed : result.computed) {
      if (!computed.result.verified()) continue;
      const LoopClosure& closure = *computed.result.closure;
      all.add(closure, mission.reference);
      if (closure.from - closure.to <= 4) near.add(closure, mission.reference);
      if (computed.weight > 0.5) worst_inlier_m = std::max(worst_inlier_m, all.m.back());
    }
    REQUIRE(near.m.size() > 5);
    REQUIRE(median(near.m) <= 0.04);  // fast: measured 0.017 m, 0.11 deg, largest 0.10 m
    REQUIRE(median(near.deg) <= 0.3);
    REQUIRE(*std::max_element(near.m.begin(), near.m.end()) <= 0.15);
    REQUIRE(all.m.size() > 30);
    REQUIRE(median(all.m) <= 0.10);  // measured 0.034 m, 0.27 deg
    REQUIRE(median(all.deg) <= 0.5);
    REQUIRE(worst_inlier_m <= 0.4);  // measured 0.21 m
  }
}

TEST_CASE("session: closures take the drift out of noisy odometry", "[replay][data]") {
  const auto path = testing::test_data("kaist03");
  if (!path) return;
  const Mission mission = read_mission(*path);
  int much_better = 0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    ReplayOptions config = session_config();
    config.odometry_noise_m_per_m = 0.05;
    config.odometry_noise_rad_per_m = 0.01;
    config.engine.seed = seed;
    const ReplayResult result = replay_session(mission, config);
    const double drifted = aligned_error(result.odometry, mission, result.graph);
    const double optimized = aligned_error(result.graph.poses(), mission, result.graph);
    CAPTURE(drifted, optimized);
    REQUIRE(optimized <= 0.3);
    much_better += optimized <= drifted / 3.0 ? 1 : 0;  // measured ratios about 0.2
  }
  REQUIRE(much_better >= 4);
}

}  // namespace loopwise::session_test
