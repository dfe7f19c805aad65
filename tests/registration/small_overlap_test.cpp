// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Scans that overlap little: what they need to be verified, and how soon the others are refused.
#include <loopwise/core/clock.hpp>
#include <loopwise/core/robust_centre.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/registration/closure_tests.hpp>
#include <loopwise/registration/fast_registrar.hpp>

#include "normal_bins.hpp"
#include "pose_search.hpp"
#include "rooms.hpp"
#include "scene.hpp"
#include "testing.hpp"

namespace loopwise::small_overlap_test {
namespace {

Side side_of(FeatureCache& features, Key key, const FastRegistrarOptions& options) {
  RegistrationResult ignored;
  Side out;
  out.submap = *Submap::load(features, {{key, Eigen::Isometry3d::Identity()}}, 0, ignored);
  out.order = draw_balanced(out.submap.cloud(), static_cast<std::size_t>(options.fine_points));
  out.range_image = RangeImage(out.submap.cloud());
  out.centre = robust_centre(out.submap.cloud().points);
  out.share = surface_share(out.submap.cloud(), out.submap.tree(), options.tests);
  return out;
}

TEST_CASE("PoseSearch: poses without overlap are dropped before they settle", "[parts][small_overlap]") {
  const FastRegistrarOptions options;
  Rng rng(71);
  const testing::Scene scene(71);
  const Eigen::Isometry3d here = testing::ground_pose(0, 0, 0), near = testing::ground_pose(3, 1, 0.4);
  FeatureCache features(
      testing::loader({{0, scene.scan(here, 8000, rng)}, {1, scene.scan(near, 8000, rng)}}));
  const Side target = side_of(features, 0, options), same = side_of(features, 1, options);
  const RegistrationTask task = pair_task(1, 0, 1);
  const auto decide = [&](const Side& source, const Eigen::Isometry3d& start) {
    RegistrationResult result;
    PoseSearch search(source, target, task, options, result);
    search.refine(start);
    REQUIRE_FALSE(search.empty());
    REQUIRE(search.decide(Deadline(0.0)));
    // A pose that is only refused after it has settled stays for the comparison with later poses.
    return std::pair(result.verified(), search.empty());
  };
  REQUIRE(decide(same, here.inverse() * near) == std::pair(true, false));
  Eigen::Isometry3d away = here.inverse() * near;
  away.translation() += Eigen::Vector3d(24.0, -14.0, 0.0);
  REQUIRE(decide(same, away) == std::pair(false, true));
}

TEST_CASE("measure_alignment: what is expected of an overlap is what its own points show",
          "[closure_tests][small_overlap]") {
  // Ground that is smooth for x < 0 and rough beyond. Only the rough part is in the other scan.
  Rng rng(5);
  const ClosureTestOptions options;
  PointCloud all, rough;
  for (int i = 0; i < 8000; ++i) {
    const double x = rng.uniform(-10, 10);
    all.points.emplace_back(static_cast<float>(x), static_cast<float>(rng.uniform(-10, 10)),
                            static_cast<float>(x < 0 ? 0.0 : rng.normal(0.0, 0.08)));
    all.normals.push_back(Eigen::Vector3f::UnitZ());
    if (x < 0) continue;
    rough.points.emplace_back(static_cast<float>(x), static_cast<float>(rng.uniform(-10, 10)),
                              static_cast<float>(rng.normal(0.0, 0.08)));
    rough.normals.push_back(Eigen::Vector3f::UnitZ());
  }
  const KdTree all_tree(all.points), rough_tree(rough.points);
  const auto of_all = plane_neighbours(all, all_tree, options);
  const auto of_rough = plane_neighbours(rough, rough_tree, options);
  const double whole = surface_share(all, all_tree, options).on_plane;
  const PlaneExpectation expectation{of_all, of_rough, whole};
  const AlignmentFigures figures =
      measure_alignment(all, rough, rough_tree, Eigen::Isometry3d::Identity(), options, &expectation);
  CAPTURE(whole, figures.on_plane, figures.expected_on_plane);
  REQUIRE(figures.on_plane < whole - 0.1);
  REQUIRE(std::abs(figures.on_plane / figures.expected_on_plane - 1.0) < 0.1);
  // A few points do not decide: each side counts twenty more with the share of the whole.
  PointCloud one;
  one.points = {rough.points.front()};
  one.normals = {Eigen::Vector3f::UnitZ()};
  const std::vector<PlaneNeighbour> off{PlaneNeighbour::kOffPlane};
  const PlaneExpectation few{off, of_rough, 0.9};
  REQUIRE(measure_alignment(one, rough, rough_tree, Eigen::Isometry3d::Identity(), options, &few)
              .expected_on_plane > 0.85);
}

TEST_CASE("consistency: free space weighs more if few points overlap", "[closure_tests][small_overlap]") {
  AlignmentFigures figures;
  figures.on_plane = 0.9;
  figures.contradiction = 0.01;
  for (const double overlap : {1.0, 0.5}) {
    figures.overlap = overlap;
    REQUIRE(consistency(figures) == Approx(0.85));
  }
  figures.overlap = 0.25;
  REQUIRE(consistency(figures) == Approx(0.8));
  figures.expected_overlap = 0.5;  // half of what the scan's density allows
  REQUIRE(consistency(figures) == Approx(0.85));
  figures.overlap = 0.0;
  REQUIRE(consistency(figures) == Approx(0.4));
}

TEST_CASE("judge_alignment: a small overlap needs a higher consistency", "[closure_tests][small_overlap]") {
  ClosureTestOptions options = FastRegistrarOptions::default_tests();
  options.min_overlap = 0.15;
  AlignmentFigures figures;
  figures.balanced_overlap = 0.3;
  figures.plane_rmse_m = 0.05;
  figures.hessian = figures.source_hessian = 1000.0 * Matrix6d::Identity();
  const auto reason = [&](double overlap, double balanced, double on_plane) {
    figures.overlap = overlap;
    figures.balanced_overlap = balanced;
    figures.on_plane = on_plane;
    RegistrationResult result;
    judge_alignment(result, Eigen::Isometry3d::Identity(), figures, true, {}, options);
    return result.reason;
  };
  REQUIRE(reason(0.6, 0.3, 0.88) == RejectionReason::kNone);
  REQUIRE(reason(0.25, 0.3, 0.88) == RejectionReason::kInconsistent);
  REQUIRE(reason(0.25, 0.3, 0.96) == RejectionReason::kNone);
  REQUIRE(reason(0.6, 0.2, 0.95) == RejectionReason::kLowOverlap);
  REQUIRE(reason(0.25, 0.2, 0.96) == RejectionReason::kNone);
  REQUIRE(reason(0.25, 0.1, 0.95) == RejectionReason::kLowOverlap);
  REQUIRE(reason(0.14, 0.14, 1.0) == RejectionReason::kLowOverlap);
  options.min_overlap = 0.8;
  REQUIRE(reason(0.6, 0.3, 1.0) == RejectionReason::kLowOverlap);
}

TEST_CASE("FastRegistrar: a raised min_overlap holds for every closure", "[registrar][small_overlap]") {
  int verified = 0;
  for (std::uint64_t seed = 310; seed < 316; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    const testing::Scene scene(seed);
    const Eigen::Isometry3d a = testing::ground_pose(-4, 0, 0.2), b = testing::ground_pose(4, 1, 0.9);
    const auto features = std::make_shared<FeatureCache>(
        testing::loader({{0, scene.scan(a, 8000, rng)}, {1, scene.scan(b, 8000, rng)}}));
    RegistrationTask task = pair_task(1, 0, 1);
    task.guess_from_to = b.inverse() * a;
    if (!FastRegistrar(features).compute(task).verified()) continue;
    FastRegistrarOptions options;
    options.tests.min_overlap = 0.999;
    REQUIRE(FastRegistrar(features, options).compute(task).reason == RejectionReason::kLowOverlap);
    ++verified;
  }
  CAPTURE(verified);
  REQUIRE(verified >= 5);
}

TEST_CASE("FastRegistrar: votes of surfaces find a pose that descriptors and guess miss",
          "[registrar][small_overlap]") {
  FastRegistrarOptions options;
  options.max_matches = 3;  // in effect no descriptors
  int verified = 0;
  for (std::uint64_t seed = 300; seed < 306; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    const testing::Scene scene(seed);
    const Eigen::Isometry3d a = testing::ground_pose(-2, 0, 0.2), b = testing::ground_pose(3, 1, 0.9);
    const FastRegistrar registrar(std::make_shared<FeatureCache>(testing::loader(
                                      {{0, scene.scan(a, 8000, rng)}, {1, scene.scan(b, 8000, rng)}})),
                                  options);
    RegistrationTask task = pair_task(1, 0, 1);
    const Eigen::Isometry3d truth = b.inverse() * a;
    task.guess_from_to = truth * se3::exp((Vector6d() << 5.0, -4.0, 0.3, 0, 0, 0.1).finished());
    const RegistrationResult result = registrar.compute(task);
    CAPTURE(result.message);
    if (!result.verified()) continue;
    REQUIRE((truth.inverse() * *result.T_from_to).translation().norm() < 0.1);
    ++verified;
  }
  CAPTURE(verified);
  REQUIRE(verified >= 5);
}

}  // namespace
TEST_CASE("FastRegistrar: in a tunnel, poses with fewer votes are tried as well",
          "[registrar][small_overlap]") {
  int by_few = 0, by_more = 0, wrong = 0;
  for (std::uint64_t seed = 330; seed < 360; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    testing::Room tunnel;
    tunnel.add_level(60.0, 0.0);
    tunnel.add_level(60.0, 3.0);
    for (const double side : {-1.0, 1.0}) {  // uneven walls
      Eigen::Vector2d before(-60.0, 2.0 * side);
      while (before.x() < 60.0) {
        const Eigen::Vector2d next(before.x() + rng.uniform(0.5, 3.0), side * rng.uniform(1.5, 3.0));
        tunnel.add_wall(before, next, 0.0, 3.0);
        before = next;
      }
    }
    const Eigen::Isometry3d a = testing::ground_pose(-4, 0.3, 0.1), b = testing::ground_pose(5.5, -0.3, 0.3);
    const auto features = std::make_shared<FeatureCache>(
        testing::loader({{0, tunnel.scan(a, 0.02, rng, 24, 240)}, {1, tunnel.scan(b, 0.02, rng, 24, 240)}}));
    RegistrationTask task = pair_task(1, 0, 1);
    const Eigen::Isometry3d truth = b.inverse() * a;
    const Eigen::Vector3d along = b.linear().transpose() * Eigen::Vector3d::UnitX();
    Eigen::Isometry3d guess = truth;
    guess.pretranslate(rng.uniform(-10.0, 10.0) * along);
    task.guess_from_to = guess;
    Matrix6d covariance = 0.01 * Matrix6d::Identity();
    covariance.topLeftCorner<3, 3>() += 25.0 * along * along.transpose();
    task.guess_covariance = covariance;
    const auto verified = [&](int refined_votes) {
      FastRegistrarOptions options;
      options.refined_hypotheses = 1;
      options.refined_votes = refined_votes;
      const RegistrationResult result = FastRegistrar(features, options).compute(task);
      if (!result.verified()) return 0;
      const bool right = (truth.inverse() * *result.T_from_to).translation().norm() < 0.5;
      if (!right) ++wrong;
      return right ? 1 : 0;
    };
    by_few += verified(1);
    by_more += verified(FastRegistrarOptions().refined_votes);
  }
  CAPTURE(by_few, by_more, wrong);
  REQUIRE(wrong == 0);
  REQUIRE(by_more >= by_few + 2);
  REQUIRE(by_more >= 27);
}

TEST_CASE("FastRegistrar: a guess is searched as far as its covariance says", "[registrar]") {
  int by_unknown = 0, by_wide = 0;
  for (std::uint64_t seed = 320; seed < 326; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    const testing::Scene scene(seed);
    const Eigen::Isometry3d a = testing::ground_pose(-2, 0, 0.2), b = testing::ground_pose(2, 1, 1.7);
    const auto features = std::make_shared<FeatureCache>(
        testing::loader({{0, scene.scan(a, 8000, rng)}, {1, scene.scan(b, 8000, rng)}}));
    RegistrationTask task = pair_task(1, 0, 1);
    const Eigen::Isometry3d truth = b.inverse() * a;
    const Vector6d error = (Vector6d() << 11.0, -9.0, 0.2, 0, 0, 0.1).finished();
    task.guess_from_to = truth * se3::exp(error);
    const auto verified = [&](double guess_sigmas = FastRegistrarOptions().guess_sigmas) {
      FastRegistrarOptions options;
      options.guess_sigmas = guess_sigmas;
      const RegistrationResult result = FastRegistrar(features, options).compute(task);
      REQUIRE(result.verified() == (result.reason == RejectionReason::kNone));
      if (!result.verified()) return 0;
      REQUIRE((truth.inverse() * *result.T_from_to).translation().norm() < 0.1);
      return 1;
    };
    const int without = verified();
    by_unknown += without;
    // Certain, but for one direction in the frame of `to`.
    const auto certain_but_for = [](const Eigen::Vector3d& direction) {
      Matrix6d covariance = 0.01 * Matrix6d::Identity();
      covariance.topLeftCorner<3, 3>() += 16.0 * direction * direction.transpose();
      return covariance;
    };
    const Eigen::Vector3d along = error.head<3>().normalized();
    task.guess_covariance = certain_but_for(along);
    by_wide += verified();
    task.guess_covariance = certain_but_for(along.cross(Eigen::Vector3d::UnitZ()));
    REQUIRE(verified() == 0);
    REQUIRE(verified(/*guess_sigmas=*/0.0) == without);
  }
  CAPTURE(by_unknown, by_wide);
  REQUIRE(by_unknown >= 4);
  REQUIRE(by_wide >= 4);
}

}  // namespace loopwise::small_overlap_test
