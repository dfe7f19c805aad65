// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>

#include "testing.hpp"

namespace loopwise::trajectory_errors_test {
namespace {

constexpr double kPi = 3.14159265358979323846;

/// `robots` robots ("a", "b", ...) of `nodes` nodes each that wander about.
PosesByKey wander(Rng& rng, int robots, int nodes) {
  PosesByKey poses;
  for (int robot = 0; robot < robots; ++robot) {
    Eigen::Isometry3d pose = testing::random_pose(rng, 3.0);
    for (int i = 0; i < nodes; ++i) {
      poses[make_key(static_cast<char>('a' + robot), static_cast<std::uint64_t>(i))] = pose;
      Vector6d step;
      step << 2.0, 0.1 * rng.normal(), 0.1 * rng.normal(), 0.05 * rng.normal(), 0.05 * rng.normal(),
          0.2 * rng.normal();
      pose = pose * se3::exp(step);
    }
  }
  return poses;
}

PosesByKey disturbed(Rng& rng, const PosesByKey& poses, double sigma_m, double sigma_rad) {
  PosesByKey out;
  for (const auto& [key, pose] : poses) {
    Vector6d noise;
    for (int i = 0; i < 6; ++i) noise[i] = (i < 3 ? sigma_m : sigma_rad) * rng.normal();
    out[key] = pose * se3::exp(noise);
  }
  return out;
}

PosesByKey moved(const Eigen::Isometry3d& T, const PosesByKey& poses) {
  PosesByKey out;
  for (const auto& [key, pose] : poses) out[key] = T * pose;
  return out;
}

/// Nodes along x at the given distances, all with the same orientation.
PosesByKey along_x(const std::vector<double>& x, Key first = 0) {
  PosesByKey poses;
  for (std::size_t i = 0; i < x.size(); ++i) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation().x() = x[i];
    poses[first + i] = pose;
  }
  return poses;
}

Eigen::Isometry3d yaw(double angle, const Eigen::Vector3d& translation = Eigen::Vector3d::Zero()) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, angle));
  T.translation() = translation;
  return T;
}

double squared_cost(const Eigen::Isometry3d& S, const PosesByKey& estimate, const PosesByKey& truth) {
  double cost = 0.0;
  for (const auto& [key, pose] : estimate) {
    cost += (truth.at(key).translation() - S * pose.translation()).squaredNorm();
  }
  return cost;
}

}  // namespace

TEST_CASE("statistics: by hand", "[evaluation]") {
  const Statistics odd = statistics({3.0, 0.0, 1.0});
  REQUIRE(odd.count == 3);
  REQUIRE(odd.mean == Approx(4.0 / 3.0));
  REQUIRE(odd.rmse == Approx(std::sqrt(10.0 / 3.0)));
  REQUIRE(odd.median == 1.0);
  REQUIRE(odd.max == 3.0);
  REQUIRE(statistics({4.0, 1.0, 2.0, 9.0}).median == 3.0);
  REQUIRE(statistics({}).count == 0);
  REQUIRE(std::isnan(statistics({}).rmse));
}

TEST_CASE("trajectory errors: by hand, without alignment", "[evaluation]") {
  // Robot 0 goes straight for 4 m, and is estimated 10 % too long; robot 1 is 90 degrees off on its second
  // node.
  const Robots robots = parse_robots("0-2,b=10-11");
  PosesByKey truth = along_x({0.0, 2.0, 4.0});
  PosesByKey estimate = along_x({0.0, 2.2, 4.4});
  for (const auto& [key, pose] : along_x({5.0, 8.0}, 10)) truth[key] = estimate[key] = pose;
  estimate[11].linear() = yaw(kPi / 2).linear();
  truth[12] = yaw(0.0);
  estimate[3] = estimate[4] = yaw(0.0);

  const TrajectoryErrors errors =
      evaluate_trajectory(estimate, truth, Alignment::kNone, robots, {{2.0, 4.0}, 1.0});
  REQUIRE(errors.poses == 5);
  REQUIRE(errors.only_in_estimate == 2);
  REQUIRE(errors.only_in_truth == 1);
  // e = 0, 0.2, 0.4, 0, 0 and θ = 0, 0, 0, 0, π/2
  REQUIRE(errors.ate_m.mean == Approx(0.12));
  REQUIRE(errors.ate_m.rmse == Approx(0.2));
  REQUIRE(errors.ate_m.median == Approx(0.0).margin(1e-12));
  REQUIRE(errors.ate_m.max == Approx(0.4));
  REQUIRE(errors.ate_rad.mean == Approx(kPi / 10));
  REQUIRE(errors.ate_rad.max == Approx(kPi / 2));

  REQUIRE(errors.step.translation_m.count == 3);  // none between robots
  REQUIRE(errors.step.translation_m.mean == Approx(0.4 / 3));
  REQUIRE(errors.step.rotation_rad.max == Approx(kPi / 2));
  REQUIRE(errors.step.translation_percent == Approx(100.0 * (0.1 + 0.1 + 0.0) / 3));
  REQUIRE(errors.step.rotation_deg_per_m == Approx(90.0 / 3.0 / 3.0));

  REQUIRE(errors.by_distance.size() == 2);
  REQUIRE(errors.by_distance[0].distance_m == 2.0);
  REQUIRE(errors.by_distance[0].translation_m.count == 3);
  REQUIRE(errors.by_distance[1].translation_m.count == 1);
  REQUIRE(errors.by_distance[1].translation_m.max == Approx(0.4));
  REQUIRE(errors.by_distance[1].translation_percent == Approx(10.0));

  REQUIRE(errors.robots.size() == 2);
  REQUIRE(errors.robots[0].name == "0");
  REQUIRE(errors.robots[0].poses == 3);
  REQUIRE(errors.robots[0].path_length_m == Approx(4.0));
  REQUIRE(errors.robots[0].path_length_estimate_m == Approx(4.4));
  REQUIRE(errors.robots[0].translation_percent ==
          Approx(10.0));  // 0.2/2 and 0.4/4; the first node has no path
  REQUIRE(errors.robots[0].rotation_deg_per_m == Approx(0.0).margin(1e-9));
  REQUIRE(errors.robots[1].name == "b");
  REQUIRE(errors.robots[1].path_length_m == Approx(3.0));
  REQUIRE(errors.robots[1].rotation_deg_per_m == Approx(30.0));
  REQUIRE(errors.robots[1].ate_rad.max == Approx(kPi / 2));
}

TEST_CASE("trajectory errors: a perfect estimate has no error with any alignment", "[evaluation][property]") {
  const unsigned seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  Rng rng(seed);
  const PosesByKey truth = wander(rng, 3, 40);
  for (const Alignment alignment : {Alignment::kNone, Alignment::kFirst, Alignment::kSe3}) {
    const TrajectoryErrors errors = evaluate_trajectory(truth, truth, alignment);
    REQUIRE(errors.poses == 120);
    REQUIRE(errors.robots.size() == 3);
    REQUIRE(errors.ate_m.max < 1e-12);    // measured: 6e-14
    REQUIRE(errors.ate_rad.max < 1e-12);  // measured: 2e-16
    REQUIRE(errors.step.translation_m.max < 1e-12);
    REQUIRE(errors.robots[2].translation_percent < 1e-10);
    REQUIRE(errors.robots[2].path_length_m == errors.robots[2].path_length_estimate_m);
  }
}

TEST_CASE("alignment: a moved estimate is moved back", "[evaluation][property]") {
  const unsigned seed = GENERATE(range(1u, 11u));
  CAPTURE(seed);
  Rng rng(seed);
  const PosesByKey truth = wander(rng, 2, 30);
  const Eigen::Isometry3d T = testing::random_pose(rng, 50.0);
  for (const Alignment alignment : {Alignment::kFirst, Alignment::kSe3}) {
    const AlignmentResult result = align(moved(T.inverse(), truth), truth, alignment);
    REQUIRE(testing::difference(result.T_truth_estimate, T) < 1e-10);  // measured: 7e-14
    REQUIRE(result.support == AlignmentSupport::kPositions);
  }
  REQUIRE(testing::difference(align(moved(T, truth), truth, Alignment::kNone).T_truth_estimate,
                              Eigen::Isometry3d::Identity()) == 0.0);
}

TEST_CASE("alignment: se3 equals Eigen's Umeyama, and no small motion improves it",
          "[evaluation][differential]") {
  const unsigned seed = GENERATE(range(1u, 11u));
  CAPTURE(seed);
  Rng rng(seed);
  const PosesByKey truth = wander(rng, 2, 25);
  const PosesByKey estimate = moved(testing::random_pose(rng, 20.0), disturbed(rng, truth, 1.0, 0.3));
  Eigen::Matrix3Xd from(3, 50), to(3, 50);
  int column = 0;
  for (const auto& [key, pose] : estimate) {
    from.col(column) = pose.translation();
    to.col(column++) = truth.at(key).translation();
  }
  const Eigen::Isometry3d S = align(estimate, truth, Alignment::kSe3).T_truth_estimate;
  const Eigen::Matrix4d reference = Eigen::umeyama(from, to, false);
  REQUIRE((S.matrix() - reference).cwiseAbs().maxCoeff() < 1e-9);  // measured: 4e-14

  const double best = squared_cost(S, estimate, truth);
  for (int i = 0; i < 100; ++i) {
    Vector6d step;
    for (int k = 0; k < 6; ++k) step[k] = 1e-3 * rng.normal();
    REQUIRE(squared_cost(S * se3::exp(step), estimate, truth) > best);
  }
}

TEST_CASE("alignment: mirrored positions still give a rotation", "[evaluation]") {
  Rng rng(3);
  const PosesByKey truth = wander(rng, 1, 20);
  PosesByKey estimate = truth;
  for (auto& [key, pose] : estimate) pose.translation().z() *= -1.0;
  const Eigen::Matrix3d R = align(estimate, truth, Alignment::kSe3).T_truth_estimate.linear();
  REQUIRE(R.determinant() == Approx(1.0));
  REQUIRE((R.transpose() * R).isIdentity(1e-12));
}

TEST_CASE("alignment: orientations determine the rotation about a straight path",
          "[evaluation][degenerate]") {
  const unsigned seed = GENERATE(range(1u, 11u));
  CAPTURE(seed);
  Rng rng(seed);
  const Eigen::Vector3d direction = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
  PosesByKey truth;
  for (Key key = 0; key < 20; ++key) {
    truth[key] = testing::random_pose(rng, 0.0);
    truth[key].translation() =
        Eigen::Vector3d(100.0, -50.0, 7.0) + 2.0 * static_cast<double>(key) * direction;
  }
  const Eigen::Isometry3d T = testing::random_pose(rng, 50.0);
  const AlignmentResult result = align(moved(T.inverse(), truth), truth, Alignment::kSe3);
  REQUIRE(result.support == AlignmentSupport::kLine);
  REQUIRE(testing::difference(result.T_truth_estimate, T) < 1e-10);  // measured: 9e-14

  // With noise on the orientations: no other angle about the line agrees better with them.
  PosesByKey noisy = disturbed(rng, truth, 0.0, 0.2);
  const Eigen::Isometry3d S = align(noisy, truth, Alignment::kSe3).T_truth_estimate;
  const auto disagreement = [&](double angle) {
    const Eigen::Matrix3d R = se3::so3_exp(angle * direction) * S.linear();
    double sum = 0.0;
    for (const auto& [key, pose] : noisy) sum += (truth.at(key).linear() - R * pose.linear()).squaredNorm();
    return sum;
  };
  for (const double angle : {-3.0, -1.0, -0.1, -1e-3, 1e-3, 0.1, 1.0, 3.0}) {
    REQUIRE(disagreement(angle) > disagreement(0.0));
  }
  REQUIRE(squared_cost(S, noisy, truth) < 1e-20);  // the positions come first; measured: 3e-27
}

TEST_CASE("alignment: a path narrower than its errors is a line", "[evaluation][degenerate]") {
  for (const double width : {0.02, 5.0}) {
    CAPTURE(width);
    Rng rng(11);
    PosesByKey truth, estimate;
    for (Key key = 0; key < 40; ++key) {
      Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
      const double y = rng.normal(0.0, width), z = rng.normal(0.0, width);
      pose.translation() = Eigen::Vector3d(static_cast<double>(key), y, z);
      truth[key] = pose;
      for (int axis = 0; axis < 3; ++axis) pose.translation()[axis] += rng.normal(0.0, 0.1);
      pose.linear() = se3::so3_exp(Eigen::Vector3d(rng.normal(0.0, 0.01), 0.0, 0.0));
      estimate[key] = pose;
    }
    const TrajectoryErrors errors = evaluate_trajectory(estimate, truth, Alignment::kSe3);
    REQUIRE(errors.applied.support == (width < 0.1 ? AlignmentSupport::kLine : AlignmentSupport::kPositions));
    REQUIRE(errors.ate_rad.mean < 0.03);  // measured 0.008 for both
    REQUIRE(errors.ate_m.rmse < 0.2);
  }
}

TEST_CASE("alignment: one pose, two poses, a robot that never moved", "[evaluation][degenerate]") {
  Rng rng(5);
  PosesByKey truth;
  for (Key key = 0; key < 7; ++key) {  // their mean is off by rounding
    truth[key] = testing::random_pose(rng, 0.0);
    truth[key].translation() = Eigen::Vector3d(1000.1, 2000.3, -30.7);
  }
  const Eigen::Isometry3d T = testing::random_pose(rng, 50.0);
  AlignmentResult result = align(moved(T.inverse(), truth), truth, Alignment::kSe3);
  REQUIRE(result.support == AlignmentSupport::kPoint);
  REQUIRE(testing::difference(result.T_truth_estimate, T) < 1e-9);  // measured: 4e-13

  const PosesByKey one{{7, testing::random_pose(rng)}};
  result = align(moved(T.inverse(), one), one, Alignment::kSe3);
  REQUIRE(result.support == AlignmentSupport::kPoint);
  REQUIRE(testing::difference(result.T_truth_estimate, T) < 1e-10);
  const TrajectoryErrors errors = evaluate_trajectory(one, one, Alignment::kSe3);
  REQUIRE(errors.poses == 1);
  REQUIRE(errors.step.translation_m.count == 0);
  REQUIRE(std::isnan(errors.robots[0].translation_percent));

  const PosesByKey two{{7, testing::random_pose(rng)}, {8, testing::random_pose(rng)}};
  result = align(moved(T.inverse(), two), two, Alignment::kSe3);
  REQUIRE(result.support == AlignmentSupport::kLine);
  REQUIRE(testing::difference(result.T_truth_estimate, T) < 1e-10);
}

TEST_CASE(
    "trajectory errors: a common motion changes nothing, one of the estimate only ATE without alignment",
    "[evaluation][property]") {
  const unsigned seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  Rng rng(seed);
  const PosesByKey truth = wander(rng, 2, 50);
  const PosesByKey estimate = disturbed(rng, truth, 0.3, 0.05);
  const Eigen::Isometry3d T = testing::random_pose(rng, 30.0);
  const auto same = [](const Statistics& a, const Statistics& b) {
    return a.count == b.count && std::abs(a.mean - b.mean) < 1e-9 && std::abs(a.rmse - b.rmse) < 1e-9 &&
           std::abs(a.median - b.median) < 1e-9 && std::abs(a.max - b.max) < 1e-9;  // measured: 5e-14
  };
  for (const Alignment alignment : {Alignment::kNone, Alignment::kFirst, Alignment::kSe3}) {
    const TrajectoryErrors base = evaluate_trajectory(estimate, truth, alignment);
    const TrajectoryErrors both = evaluate_trajectory(moved(T, estimate), moved(T, truth), alignment);
    const TrajectoryErrors only = evaluate_trajectory(moved(T, estimate), truth, alignment);
    REQUIRE(same(base.ate_m, both.ate_m));
    REQUIRE(same(base.ate_rad, both.ate_rad));
    REQUIRE(same(base.ate_m, only.ate_m) == (alignment != Alignment::kNone));
    REQUIRE(same(base.step.translation_m, only.step.translation_m));
    REQUIRE(same(base.by_distance[1].rotation_rad, only.by_distance[1].rotation_rad));
    REQUIRE(base.robots[1].translation_percent == Approx(both.robots[1].translation_percent));
  }
  const double aligned = evaluate_trajectory(estimate, truth, Alignment::kSe3).ate_m.rmse;
  REQUIRE(aligned <= evaluate_trajectory(estimate, truth, Alignment::kNone).ate_m.rmse);
  REQUIRE(aligned <= evaluate_trajectory(estimate, truth, Alignment::kFirst).ate_m.rmse);
  REQUIRE(testing::difference(
              align(estimate, truth, Alignment::kFirst).T_truth_estimate * estimate.begin()->second,
              truth.begin()->second) < 1e-12);
}

TEST_CASE("relative errors: every pair by brute force", "[evaluation][differential]") {
  Rng rng(11);
  const PosesByKey truth = wander(rng, 2, 60);
  const PosesByKey estimate = disturbed(rng, truth, 0.3, 0.05);
  const double distance = GENERATE(0.5, 3.0, 10.0, 55.0, 1e4);
  CAPTURE(distance);
  std::vector<double> translation, rotation;
  double percent = 0.0;
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < 60; ++i) {
      double length = 0.0;
      for (std::uint64_t j = i + 1; j < 60; ++j) {
        length +=
            (truth.at(make_key(robot, j)).translation() - truth.at(make_key(robot, j - 1)).translation())
                .norm();
        if (length < distance) continue;
        const Eigen::Isometry3d is = truth.at(make_key(robot, i)).inverse() * truth.at(make_key(robot, j));
        const Eigen::Isometry3d got =
            estimate.at(make_key(robot, i)).inverse() * estimate.at(make_key(robot, j));
        translation.push_back((is.inverse() * got).translation().norm());
        rotation.push_back(Eigen::AngleAxisd((is.inverse() * got).linear()).angle());
        percent += 100.0 * translation.back() / length;
        break;
      }
    }
  }
  const RelativeErrors found =
      evaluate_trajectory(estimate, truth, Alignment::kNone, {}, {{distance}, 0.1}).by_distance.at(0);
  REQUIRE(found.translation_m.count == translation.size());
  if (translation.empty()) return;
  REQUIRE(found.translation_m.rmse == Approx(statistics(translation).rmse).epsilon(1e-9));
  REQUIRE(found.rotation_rad.mean == Approx(statistics(rotation).mean).epsilon(1e-9));
  REQUIRE(found.translation_percent ==
          Approx(percent / static_cast<double>(translation.size())).epsilon(1e-9));
}

TEST_CASE("trajectory errors: nodes without a path do not divide by it", "[evaluation]") {
  const PosesByKey truth = along_x({0.0, 0.0, 0.5, 4.0});
  const PosesByKey estimate = along_x({0.1, 0.1, 0.6, 4.2});
  const TrajectoryErrors errors = evaluate_trajectory(estimate, truth, Alignment::kNone);
  REQUIRE(errors.robots.at(0).translation_percent == Approx(5.0));  // the node at 4 m alone
  REQUIRE(errors.robots.at(0).path_length_m == Approx(4.0));
}

TEST_CASE("trajectory errors: bad input is named", "[evaluation][error]") {
  const PosesByKey good = along_x({0.0, 1.0, 2.0});
  REQUIRE_THROWS_WITH(evaluate_trajectory(good, along_x({0.0}, 9), Alignment::kSe3),
                      "the estimate (3 poses) and the truth (1 poses) have no key in common");
  REQUIRE_THROWS_AS(evaluate_trajectory({}, {}, Alignment::kNone), InputError);

  PosesByKey bad = good;
  bad[1].translation().y() = std::nan("");
  REQUIRE_THROWS_WITH(evaluate_trajectory(bad, good, Alignment::kNone),
                      "estimate: the pose of key 1 (1) is not finite");
  REQUIRE_THROWS_WITH(evaluate_trajectory(good, bad, Alignment::kSe3),
                      "truth: the pose of key 1 (1) is not finite");
  bad = good;
  bad[2].linear() *= 1.1;
  REQUIRE_THROWS_WITH(align(bad, good, Alignment::kFirst), "estimate: the pose of key 2 (2) has no rotation");
  bad[2].linear() = Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal();
  REQUIRE_THROWS_WITH(align(good, bad, Alignment::kFirst), Contains("has no rotation"));

  REQUIRE_THROWS_AS(evaluate_trajectory(good, good, Alignment::kNone, parse_robots("0-1")), UnknownKeyError);
  REQUIRE_THROWS_WITH(evaluate_trajectory(good, good, Alignment::kNone, {}, {{0.0}, 1.0}),
                      "distances_m = 0, must be > 0");
}

TEST_CASE("alignment: the words of the command line", "[evaluation]") {
  REQUIRE(parse_enum<Alignment>("alignment", "se3") == Alignment::kSe3);
  REQUIRE(enum_name(Alignment::kFirst) == "first");
  REQUIRE(enum_name(AlignmentSupport::kLine) == "line");
}

TEST_CASE("trajectory errors: the poses of a graph", "[evaluation]") {
  PoseGraph graph;
  Node node;
  node.key = make_key('z', 3);
  node.pose = yaw(0.3, Eigen::Vector3d(1.0, 2.0, 3.0));
  graph.add_node(node);
  const PosesByKey poses = poses_by_key(graph);
  REQUIRE(poses.size() == 1);
  REQUIRE(testing::difference(poses.at(node.key), node.pose) == 0.0);
}

}  // namespace loopwise::trajectory_errors_test
