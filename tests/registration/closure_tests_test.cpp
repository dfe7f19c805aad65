// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/closure_tests.hpp>

#include <limits>

#include <Eigen/Eigenvalues>

#include "testing.hpp"

namespace loopwise::closure_tests_test {
namespace {

/// A target of scattered points with random normals, and a source that lies on it under the given pose.
struct Pair {
  PointCloud target;
  PointCloud source;
  KdTree tree;

  Pair(Rng& rng, const Eigen::Isometry3d& T_from_to, double offset_m) {
    for (int i = 0; i < 200; ++i) {
      const Eigen::Vector3d p(rng.uniform(-20, 20), rng.uniform(-20, 20), rng.uniform(-20, 20));
      const Eigen::Vector3d n = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
      target.points.push_back(p.cast<float>());
      target.normals.push_back(n.cast<float>());
      source.points.push_back((T_from_to * (p + offset_m * n)).cast<float>());
    }
    tree = KdTree(target.points);
  }
};

TEST_CASE("measure_alignment: the Hessian is that of the point-to-plane cost", "[closure_tests][jacobian]") {
  Rng rng(3);
  const Eigen::Isometry3d T_from_to = testing::random_pose(rng, 5.0, 1.0);
  const Pair pair(rng, T_from_to, 0.1);
  const AlignmentFigures figures =
      measure_alignment(pair.source, pair.target, pair.tree, T_from_to.inverse(), {});
  REQUIRE(figures.plane_points == 200);
  REQUIRE(figures.source_hessian == figures.hessian);  // the source has no normals of its own
  REQUIRE(figures.overlap == 1.0);
  REQUIRE(figures.fitness_m2 == Approx(0.01).epsilon(1e-3));
  REQUIRE(figures.plane_rmse_m == Approx(0.1).epsilon(1e-3));

  const auto residual = [&](std::size_t i, const Vector6d& xi) {
    const Eigen::Vector3d y = (T_from_to * se3::exp(xi)).inverse() * pair.source.points[i].cast<double>();
    return pair.target.normals[i].cast<double>().dot(y - pair.target.points[i].cast<double>());
  };
  Matrix6d numeric = Matrix6d::Zero();
  for (std::size_t i = 0; i < pair.source.size(); ++i) {
    Vector6d j;
    for (Eigen::Index k = 0; k < 6; ++k) {
      const Vector6d step = 1e-5 * Vector6d::Unit(k);
      j[k] = (residual(i, step) - residual(i, -step)) / 2e-5;
    }
    numeric += j * j.transpose();
  }
  // Measured 2e-10 of the largest element; a wrong frame or sign is off by the order of 1.
  Matrix6d noise = Matrix6d::Zero();
  for (const Eigen::Vector3f& p : pair.source.points) {
    Eigen::Matrix<double, 3, 6> G;
    G << Eigen::Matrix3d::Identity(), -se3::skew(T_from_to.inverse() * p.cast<double>());
    noise += G.transpose() * G;
  }
  REQUIRE((noise - figures.normal_noise).cwiseAbs().maxCoeff() < 1e-9 * noise.cwiseAbs().maxCoeff());
  REQUIRE((numeric - figures.hessian).cwiseAbs().maxCoeff() < 1e-7 * numeric.cwiseAbs().maxCoeff());
}

TEST_CASE("measure_alignment: limits count as stated", "[closure_tests]") {
  PointCloud target;
  target.points = {{0, 0, 0}};
  target.normals = {{0, 0, 1}};
  const KdTree tree(target.points);
  ClosureTestOptions options;
  options.fitness_range_m = 2.0;
  PointCloud source;
  source.points = {{0.3F, 0, 0.4F}, {0, 1, 0}, {0, 50, 0}, {0, 0, 0}};
  const AlignmentFigures figures =
      measure_alignment(source, target, tree, Eigen::Isometry3d::Identity(), options);
  REQUIRE(figures.fitness_m2 == Approx((0.25 + 1.0 + 4.0) / 4.0));
  REQUIRE(figures.overlap == 0.5);  // the bound itself, 0.5 m, is inside
  REQUIRE(figures.plane_rmse_m == Approx(std::sqrt(0.16 / 2.0)));
  REQUIRE(measure_alignment(PointCloud(), target, tree, Eigen::Isometry3d::Identity(), options).overlap ==
          0.0);
}

TEST_CASE("measure_alignment: every direction of surfaces counts alike", "[closure_tests]") {
  // 90 points of ground match, and ten of a wall do not: both surfaces have the same weight.
  PointCloud source, target;
  for (int i = 0; i < 90; ++i) {
    source.points.emplace_back(static_cast<float>(i), 0.0F, 0.0F);
    source.normals.emplace_back(0.0F, 0.0F, 1.0F);
  }
  target = source;
  for (int i = 0; i < 10; ++i) {
    source.points.emplace_back(0.0F, 5.0F + static_cast<float>(i), 3.0F);
    source.normals.emplace_back(i % 2 == 0 ? 1.0F : -1.0F, 0.0F, 0.0F);
  }
  const auto balanced = [&] {
    return measure_alignment(source, target, KdTree(target.points), Eigen::Isometry3d::Identity(), {})
        .balanced_overlap;
  };
  REQUIRE(balanced() == Approx(0.5));
  // Points that lie on the target across its surface do not count.
  for (std::size_t i = 0; i < 45; ++i) source.normals[i] = Eigen::Vector3f::UnitY();
  REQUIRE(balanced() == Approx(1.0 / 3.0));
}

TEST_CASE("measure_alignment: the two faces of a wall are different surfaces", "[closure_tests]") {
  PointCloud target;
  for (int i = 0; i < 100; ++i) {
    const int row = i / 10;
    target.points.emplace_back(0.3F, 0.5F * static_cast<float>(i % 10), 0.5F * static_cast<float>(row));
    target.normals.push_back(Eigen::Vector3f::UnitX());
  }
  PointCloud source = target;
  for (Eigen::Vector3f& p : source.points) p.x() = 0.0F;
  const auto figures = [&] {
    return measure_alignment(source, target, KdTree(target.points), Eigen::Isometry3d::Identity(), {});
  };
  REQUIRE(figures().plane_points == 100);
  for (Eigen::Vector3f& n : source.normals) n = -n;
  REQUIRE(figures().overlap == 1.0);
  REQUIRE(figures().plane_points == 0);
  REQUIRE(figures().balanced_overlap == 0.0);
}

TEST_CASE("closure_covariance: symmetric, positive definite and bounded for any Hessian",
          "[closure_tests][property]") {
  Rng rng(5);
  const ClosureTestOptions options;
  for (int trial = 0; trial < 200; ++trial) {
    const auto rank = static_cast<Eigen::Index>(rng.below(7));
    const Eigen::MatrixXd root = Eigen::MatrixXd::NullaryExpr(6, rank, [&] { return rng.normal(); });
    AlignmentFigures figures;
    if (rank > 0)
      figures.source_hessian = figures.hessian =
          std::pow(10.0, rng.uniform(-6.0, 9.0)) * root * root.transpose();
    figures.plane_rmse_m = rng.uniform(0.0, 0.5);
    const Matrix6d covariance = closure_covariance(figures, options);
    REQUIRE(covariance.allFinite());
    REQUIRE(covariance == covariance.transpose());
    const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(covariance);
    REQUIRE(solver.eigenvalues()[0] >= 0.99 * options.min_sigma_rad * options.min_sigma_rad);
    for (Eigen::Index i = 0; i < 6; ++i) {
      const double max = i < 3 ? options.max_sigma_m : options.max_sigma_rad;
      REQUIRE(covariance(i, i) <= 1.01 * max * max);
    }
    REQUIRE(free_directions(figures, options) >= 6 - static_cast<int>(rank));
  }
}

TEST_CASE("closure_covariance: a well constrained pair gets the Hessian's inverse", "[closure_tests]") {
  Rng rng(7);
  const Pair pair(rng, Eigen::Isometry3d::Identity(), 0.08);
  const ClosureTestOptions options;
  const AlignmentFigures figures =
      measure_alignment(pair.source, pair.target, pair.tree, Eigen::Isometry3d::Identity(), options);
  const Matrix6d told = figures.hessian - 0.05 * 0.05 * figures.normal_noise;
  Matrix6d expected = 0.08 * 0.08 * options.points_per_sample * told.inverse();
  expected.diagonal().head<3>().array() += options.min_sigma_m * options.min_sigma_m;
  expected.diagonal().tail<3>().array() += options.min_sigma_rad * options.min_sigma_rad;
  REQUIRE(free_directions(figures, options) == 0);
  REQUIRE((closure_covariance(figures, options) - expected).cwiseAbs().maxCoeff() <
          1e-4 * expected.cwiseAbs().maxCoeff());  // measured 1e-6: points in float
}

TEST_CASE("closure_covariance: a corridor's free direction shows", "[closure_tests]") {
  Rng rng(9);
  Pair pair(rng, Eigen::Isometry3d::Identity(), 0.0);
  for (auto& n : pair.target.normals) n = Eigen::Vector3f(0.0F, n.y(), n.z()).normalized();
  const ClosureTestOptions options;
  const AlignmentFigures figures =
      measure_alignment(pair.source, pair.target, pair.tree, Eigen::Isometry3d::Identity(), options);
  REQUIRE(free_directions(figures, options) == 1);
  const Matrix6d covariance = closure_covariance(figures, options);
  REQUIRE(covariance(0, 0) > 0.9 * options.max_sigma_m * options.max_sigma_m);
  REQUIRE(covariance(1, 1) < 0.01);
  REQUIRE(covariance(2, 2) < 0.01);
}

TEST_CASE("judge_alignment: each test has its reason, and one that passes is a closure", "[closure_tests]") {
  AlignmentFigures good;
  good.fitness_m2 = 0.1;
  good.overlap = 0.8;
  good.balanced_overlap = 0.7;
  good.plane_rmse_m = 0.05;
  good.plane_points = 1000;
  good.source_hessian = good.hessian = 1000.0 * Matrix6d::Identity();
  const Eigen::Isometry3d T = se3::exp((Vector6d() << 3, 4, 0, 0, 0, 0.5).finished());
  const auto judge = [&](const AlignmentFigures& figures, bool converged,
                         std::optional<Eigen::Isometry3d> guess, Eigen::Isometry3d pose) {
    RegistrationResult result;
    result.candidate.from = 5;
    result.candidate.to = 2;
    judge_alignment(result, pose, figures, converged, guess, {});
    REQUIRE(result.verified() == (result.reason == RejectionReason::kNone));
    REQUIRE(result.message.empty() == result.verified());
    return result;
  };
  const RegistrationResult verified = judge(good, true, std::nullopt, T);
  REQUIRE(verified.verified());
  REQUIRE(verified.closure->from == 5);
  REQUIRE(verified.closure->to == 2);
  REQUIRE(testing::difference(verified.closure->T_from_to, T) < 1e-12);
  REQUIRE(verified.overlap == 0.8);

  Eigen::Isometry3d broken = T;
  broken.translation().x() = std::numeric_limits<double>::quiet_NaN();
  const RegistrationResult not_finite = judge(good, true, std::nullopt, broken);
  REQUIRE(not_finite.reason == RejectionReason::kNotConverged);
  REQUIRE_FALSE(not_finite.T_from_to.has_value());
  REQUIRE(judge(good, false, std::nullopt, T).reason == RejectionReason::kNotConverged);

  AlignmentFigures bad = good;
  bad.fitness_m2 = 0.91;
  REQUIRE(judge(bad, true, std::nullopt, T).message == "mean squared distance 0.91 m^2, must be <= 0.9 m^2");
  REQUIRE(judge(bad, true, std::nullopt, T).reason == RejectionReason::kGicpFitness);
  bad.fitness_m2 = std::numeric_limits<double>::quiet_NaN();
  REQUIRE(judge(bad, true, std::nullopt, T).reason == RejectionReason::kGicpFitness);
  bad = good;
  bad.overlap = 0.39;
  REQUIRE(judge(bad, true, std::nullopt, T).reason == RejectionReason::kLowOverlap);
  bad = good;
  bad.balanced_overlap = 0.21;
  REQUIRE(judge(bad, true, std::nullopt, T).reason == RejectionReason::kLowOverlap);
  bad = good;
  bad.source_hessian.topLeftCorner<3, 3>().setZero();
  REQUIRE(judge(bad, true, std::nullopt, T).reason == RejectionReason::kDegenerate);

  bad = good;
  bad.on_plane = 0.7;
  bad.expected_on_plane = 0.9;
  bad.contradiction = 0.01;
  REQUIRE(judge(bad, true, std::nullopt, T).verified());  // no test by default
  {
    ClosureTestOptions strict;
    strict.min_consistency = 0.8;
    RegistrationResult result;
    judge_alignment(result, T, bad, true, std::nullopt, strict);
    REQUIRE(result.reason == RejectionReason::kInconsistent);
    REQUIRE(result.message == "consistency 0.7278, must be >= 0.8");
    bad.on_plane = 0.78;
    judge_alignment(result, T, bad, true, std::nullopt, strict);
    REQUIRE(result.verified());
  }

  Eigen::Isometry3d far = T, turned = T;
  far.translation().x() += 20.5;
  turned.rotate(Eigen::AngleAxisd(0.9, Eigen::Vector3d::UnitX()));
  REQUIRE(judge(good, true, T, T).verified());
  REQUIRE(judge(good, true, far, T).reason == RejectionReason::kTransformThreshold);
  REQUIRE(judge(good, true, turned, T).reason == RejectionReason::kTransformThreshold);
}

TEST_CASE("surface_share: 1 on planes, less on rough ground, 1 without evidence", "[closure_tests]") {
  Rng rng(5);
  const ClosureTestOptions options;
  for (const double roughness_m : {0.0, 0.05, 0.2}) {
    PointCloud cloud;
    for (int i = 0; i < 4000; ++i) {
      cloud.points.emplace_back(static_cast<float>(rng.uniform(-8, 8)),
                                static_cast<float>(rng.uniform(-8, 8)),
                                static_cast<float>(rng.normal(0.0, roughness_m)));
      cloud.normals.push_back(Eigen::Vector3f::UnitZ());
    }
    const SurfaceShare found = surface_share(cloud, KdTree(cloud.points), options);
    const double share = found.on_plane;
    REQUIRE(found.overlap > 0.9);
    CAPTURE(roughness_m, share);
    // Differences of two: 0.08 m is 1.13 sigma, 0.742 by the normal distribution. On rougher ground the
    // nearest point is one at the same height more often than chance has it: measured 0.446 instead of 0.223.
    const double expected = roughness_m == 0.0 ? 1.0 : roughness_m == 0.05 ? 0.742 : 0.446;
    REQUIRE(std::abs(share - expected) < 0.05);
  }
  PointCloud two;
  two.points = {{0, 0, 0}, {50, 0, 0}};
  two.normals.assign(2, Eigen::Vector3f::Zero());
  REQUIRE(surface_share(two, KdTree(two.points), options).on_plane == 1.0);
  REQUIRE(surface_share({}, KdTree(), options).overlap == 1.0);
  // One in two has a neighbour.
  PointCloud half;
  for (int i = 0; i < 500; ++i) {
    for (const float x : {0.0F, 0.3F, 20.0F, 40.0F})
      half.points.emplace_back(x, 60.0F * static_cast<float>(i), 0.0F);
  }
  half.normals.assign(half.points.size(), Eigen::Vector3f::UnitZ());
  REQUIRE(std::abs(surface_share(half, KdTree(half.points), options).overlap - 0.5) < 0.01);
}

TEST_CASE("widen_covariance: raises one direction and no other", "[closure_tests]") {
  Matrix6d covariance = 0.01 * Matrix6d::Identity();
  const Eigen::Vector3d along = Eigen::Vector3d(1, 2, 2) / 3.0;
  widen_covariance(covariance, along, 2.0);
  Vector6d d = Vector6d::Zero();
  d.head<3>() = along;
  REQUIRE(std::abs(d.dot(covariance * d) - 4.0) < 1e-12);
  d.head<3>() = Eigen::Vector3d(2, -2, 1) / 3.0;
  REQUIRE(std::abs(d.dot(covariance * d) - 0.01) < 1e-12);
  const Matrix6d before = covariance;
  widen_covariance(covariance, along, 1.0);
  REQUIRE(covariance == before);
}

}  // namespace
}  // namespace loopwise::closure_tests_test
