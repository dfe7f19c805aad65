// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The parts of FastRegistrar, which are private to the library.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "consensus.hpp"
#include "fast_atan2.hpp"
#include "fpfh.hpp"
#include "gicp.hpp"
#include "matching.hpp"
#include "normal_bins.hpp"
#include "normal_equations.hpp"
#include "range_image.hpp"
#include "scene.hpp"
#include "testing.hpp"

#include <loopwise/core/robust_centre.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/fast_registrar.hpp>

namespace loopwise::parts_test {
namespace {

Eigen::Vector3f random_direction(Rng& rng) {
  return Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized().cast<float>();
}

TEST_CASE("normal_bin: opposite directions share a bin, the axes have their own", "[parts][property]") {
  Rng rng(1);
  std::vector<std::size_t> used(kNormalBins, 0);
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3f n = random_direction(rng);
    REQUIRE(normal_bin(n) < kUnknownNormal);
    REQUIRE(normal_bin(n) == normal_bin(-n));
    ++used[normal_bin(n)];
  }
  for (std::size_t bin = 0; bin < kUnknownNormal; ++bin) REQUIRE(used[bin] > 30);
  REQUIRE(normal_bin(Eigen::Vector3f::Zero()) == kUnknownNormal);
  REQUIRE(normal_bin(Eigen::Vector3f::UnitX()) != normal_bin(Eigen::Vector3f::UnitZ()));
}

TEST_CASE("draw_balanced: rare directions get their share, unknown normals none", "[parts]") {
  PointCloud cloud;
  for (int i = 0; i < 1000; ++i) {
    cloud.points.emplace_back(static_cast<float>(i), 0.0F, 0.0F);
    cloud.normals.emplace_back(i < 50 ? 1.0F : 0.0F, 0.0F, i < 100 ? 0.0F : 1.0F);
  }
  const auto drawn = draw_balanced(cloud, 80);
  REQUIRE(drawn.size() == 80);
  REQUIRE(std::count_if(drawn.begin(), drawn.end(), [](std::uint32_t i) { return i < 50; }) == 40);
  REQUIRE(draw_balanced(cloud, 5000).size() == 950);
  auto sorted = draw_balanced(cloud, 5000);
  std::sort(sorted.begin(), sorted.end());
  REQUIRE(std::adjacent_find(sorted.begin(), sorted.end()) == sorted.end());
}

TEST_CASE("compute_fpfh: does not change with the sensor's pose and distinguishes surfaces",
          "[parts][property]") {
  Rng rng(3);
  FeatureOptions options;
  options.min_points = 100000;
  const ScanFeatures scan =
      compute_features(*testing::Scene(3).scan(testing::ground_pose(0, 0, 0), 4000, rng), options);
  PointCloud turned = scan.cloud;
  const Eigen::Isometry3f T = testing::random_pose(rng, 5.0, 3.0).cast<float>();
  for (auto& p : turned.points) p = T * p;
  for (auto& n : turned.normals) n = T.linear() * n;
  std::vector<std::uint32_t> keys(200);
  std::iota(keys.begin(), keys.end(), 0);
  // More neighbours than there are: a turned tree has another order, and would take another part of them.
  const Descriptors a = compute_fpfh(scan.cloud, scan.tree, keys, 2.5, 1000);
  const Descriptors b = compute_fpfh(turned, KdTree(turned.points), keys, 2.5, 1000);
  int same = 0;
  for (Eigen::Index i = 0; i < a.cols(); ++i) {
    if (a.col(i).isZero()) continue;
    REQUIRE(a.col(i).norm() == Approx(1.0).margin(1e-4));
    REQUIRE(a.col(i).minCoeff() >= 0.0F);
    if ((a.col(i) - b.col(i)).norm() < 0.05F) ++same;
  }
  REQUIRE(same > 190);  // angles at the edge of a bin may fall to either side by rounding
  REQUIRE((a.col(0) - a.col(1)).norm() > 0.01F);
}

TEST_CASE("compute_fpfh: a point alone has the zero descriptor", "[parts][error]") {
  PointCloud cloud;
  cloud.points = {{0, 0, 0}, {100, 0, 0}};
  cloud.normals = {{0, 0, 1}, {0, 0, 1}};
  REQUIRE(compute_fpfh(cloud, KdTree(cloud.points), {0, 1}, 2.0, 40).isZero());
  REQUIRE(compute_fpfh(cloud, KdTree(cloud.points), {}, 2.0, 40).cols() == 0);
}

TEST_CASE("fit_rigid: exact on exact matches", "[parts]") {
  Rng rng(5);
  const Eigen::Isometry3d truth = testing::random_pose(rng, 10.0, 3.0);
  std::vector<Match> matches;
  for (int i = 0; i < 5; ++i) {
    const Eigen::Vector3f p = 10.0F * random_direction(rng);
    Match match;
    match.source = p;
    match.target = (truth * p.cast<double>()).cast<float>();
    matches.push_back(match);
  }
  REQUIRE(testing::difference(fit_rigid(matches, {0, 1, 2, 3, 4}), truth) <
          1e-5);  // measured 1e-6: points in float
  REQUIRE(testing::difference(fit_rigid(matches, {0, 2, 4}), truth) < 1e-5);
}

TEST_CASE("find_consensus: finds 5 % of true matches among false ones, no chance agreement", "[parts]") {
  const std::uint64_t seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  Rng rng(seed);
  const Eigen::Isometry3d truth = testing::random_pose(rng, 10.0, 3.0);
  std::vector<Match> matches;
  const auto anywhere = [&] {
    return Eigen::Vector3d(rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-3, 3))
        .cast<float>()
        .eval();
  };
  for (int i = 0; i < 600; ++i) {
    Match match{anywhere(), anywhere(), random_direction(rng), random_direction(rng)};
    if (i % 20 == 0) {
      const Eigen::Vector3d noise(rng.normal(), rng.normal(), rng.normal());
      match.target = (truth * match.source.cast<double>() + 0.1 * noise).cast<float>();
      match.target_normal = (truth.linear() * match.source_normal.cast<double>()).cast<float>();
    }
    matches.push_back(match);
  }
  const auto found = find_consensus(matches, 0.6, 10).hypotheses;
  REQUIRE_FALSE(found.empty());
  REQUIRE(found[0].inliers >= 28);
  const Eigen::Isometry3d d = truth.inverse() * found[0].T_target_source;
  REQUIRE(d.translation().norm() < 0.15);  // measured at most 0.06 m
  REQUIRE(se3::rotation_angle(d) < 0.01);  // measured at most 0.0017 rad
  for (std::size_t i = 1; i < found.size(); ++i) REQUIRE(found[i].inliers < 8);
}

TEST_CASE("find_consensus: poses that are not allowed leave their place to others", "[parts]") {
  Rng rng(9);
  std::vector<Match> matches;
  const Eigen::Isometry3d strong = testing::random_pose(rng, 10.0, 3.0),
                          weak = testing::random_pose(rng, 10.0, 3.0);
  for (int i = 0; i < 60; ++i) {
    const Eigen::Vector3d p(rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-3, 3));
    const Eigen::Isometry3d& T = i < 40 ? strong : weak;
    Match match{p.cast<float>(), (T * p).cast<float>(), random_direction(rng), Eigen::Vector3f::Zero()};
    match.target_normal = (T.linear() * match.source_normal.cast<double>()).cast<float>();
    matches.push_back(match);
  }
  REQUIRE(find_consensus(matches, 0.6, 1).hypotheses.at(0).inliers >= 40);
  const auto allowed = [&](const Eigen::Isometry3d& T) {
    return (T.translation() - strong.translation()).norm() > 0.5;
  };
  const Consensus found = find_consensus(matches, 0.6, 1, allowed);
  REQUIRE(found.refused >= 1);
  REQUIRE(found.hypotheses.size() == 1);
  REQUIRE(testing::difference(found.hypotheses[0].T_target_source, weak) < 1e-3);
}

TEST_CASE("find_consensus: too few matches or none that agree", "[parts][error]") {
  REQUIRE(find_consensus({}, 0.6, 10).hypotheses.empty());
  Match match;
  match.source = match.target = Eigen::Vector3f::Zero();
  match.source_normal = match.target_normal = Eigen::Vector3f::UnitZ();
  REQUIRE(find_consensus(std::vector<Match>(50, match), 0.6, 10).hypotheses.empty());
}

/// A refinement that knows nothing from others.
GicpResult refined(const PointCloud& source, const std::vector<std::uint32_t>& order,
                   const PointCloud& target, const KdTree& tree, const Eigen::Isometry3d& start,
                   const std::vector<GicpPass>& passes) {
  FollowedPoints followed(tree, order.size());
  return refine_gicp(source, robust_centre(source.points), order, target, followed, start, passes);
}

TEST_CASE("refine_gicp: from 1 m and 10 degrees to the truth", "[parts]") {
  const std::uint64_t seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  const testing::Scene scene(seed);
  Rng rng(seed);
  const Eigen::Isometry3d source_pose = testing::ground_pose(2, 1, 0.4),
                          target_pose = testing::ground_pose(0, 0, 0);
  const ScanFeatures source = compute_features(*scene.scan(source_pose, 15000, rng, 0.02, 20.0), {});
  const ScanFeatures target = compute_features(*scene.scan(target_pose, 15000, rng, 0.02, 20.0), {});
  const Eigen::Isometry3d truth = target_pose.inverse() * source_pose;
  Vector6d offset;
  offset << 0.6 * random_direction(rng).cast<double>(), 0.12 * random_direction(rng).cast<double>();
  const std::vector<GicpPass> passes{{2.0, 600, 15, 0.02, 2e-3}, {1.0, 600, 15, 0.01, 1e-3}, {0.5, 3000, 30}};
  const GicpResult result = refined(source.cloud, draw_balanced(source.cloud, 3000), target.cloud,
                                    target.tree, truth * se3::exp(offset), passes);
  const Eigen::Isometry3d d = truth.inverse() * result.T_target_source;
  REQUIRE(result.converged);
  REQUIRE(d.translation().norm() < 0.015);  // measured at most 0.0035 m
  REQUIRE(se3::rotation_angle(d) < 0.001);  // measured at most 0.0003 rad
}

TEST_CASE("FollowedPoints: after any move, the point that a search finds", "[parts][differential]") {
  const std::uint64_t seed = GENERATE(range(1u, 9u));
  const float offset_m = GENERATE(0.0F, 1e4F);
  CAPTURE(seed, offset_m);
  Rng rng(seed);
  const auto drawn = [&](double reach_m) {
    return Eigen::Vector3f((random_direction(rng) * rng.uniform(0.0, reach_m)).cast<float>());
  };
  std::vector<Eigen::Vector3f> target, source;
  for (int i = 0; i < 600; ++i) target.push_back(drawn(10.0) + offset_m * Eigen::Vector3f::UnitX());
  for (int i = 0; i < 400; ++i) source.push_back(drawn(14.0) + offset_m * Eigen::Vector3f::UnitX());
  for (int i = 0; i < 20; ++i) target.push_back(target.front());  // equal distances
  const KdTree tree(target);
  FollowedPoints followed(tree, source.size());
  std::size_t found = 0, none = 0;
  for (int step = 0; step < 60; ++step) {
    // Small steps as at the end of a refinement, and now and then a start elsewhere with another reach.
    const Eigen::Vector3f move = drawn(step % 15 == 0 ? 3.0 : 0.02);
    const float reach = std::array{2.0F, 1.0F, 0.5F}[static_cast<std::size_t>(step / 5 % 3)];
    for (std::size_t k = 0; k < source.size(); ++k) {
      source[k] += move;
      const auto expected = tree.nearest(source[k], reach),
                 nearest = followed.nearest(k, source[k], reach, target);
      REQUIRE(nearest.has_value() == expected.has_value());
      if (nearest) REQUIRE(nearest->index == expected->index);
      if (nearest) REQUIRE(nearest->sq_distance_m2 == expected->sq_distance_m2);
      ++(nearest ? found : none);
    }
  }
  REQUIRE(std::min(found, none) > 2000);
}

TEST_CASE("refine_gicp: a wall seen from its other side does not attract", "[parts]") {
  // Floor and one side wall fix all but x; the wall across x is 0.4 m thick, and each scan saw one face.
  PointCloud source;
  const auto add = [&](PointCloud& cloud, const Eigen::Vector3f& p, const Eigen::Vector3f& n) {
    cloud.points.push_back(p);
    cloud.normals.push_back(n);
  };
  Rng rng(3);
  for (int i = 0; i < 400; ++i) {
    const auto a = static_cast<float>(rng.uniform(-4, 4)), b = static_cast<float>(rng.uniform(0, 3));
    add(source, {a, b, 0.0F}, Eigen::Vector3f::UnitZ());
    add(source, {a, 0.0F, b}, Eigen::Vector3f::UnitY());
  }
  PointCloud target = source;
  for (int i = 0; i < 400; ++i) {
    const auto a = static_cast<float>(rng.uniform(0, 3)), b = static_cast<float>(rng.uniform(0, 3));
    add(source, {5.0F, a, b}, -Eigen::Vector3f::UnitX());
    add(target, {5.4F, a, b}, Eigen::Vector3f::UnitX());
  }
  const auto aligned = [&]() -> Eigen::Vector3d {
    const GicpResult result =
        refined(source, draw_balanced(source, source.size()), target, KdTree(target.points),
                Eigen::Isometry3d::Identity(), {{1.0, 1000, 30}});
    return result.T_target_source.translation();
  };
  REQUIRE(aligned().norm() < 0.01);  // measured 2e-5 m
  for (std::size_t i = 800; i < target.size(); ++i) target.normals[i] = -target.normals[i];
  REQUIRE(aligned().x() == Approx(0.4).margin(0.01));
}

TEST_CASE("refine_gicp: without matches it stays and says so", "[parts][error]") {
  PointCloud cloud, far;
  for (int i = 0; i < 50; ++i) {
    cloud.points.emplace_back(static_cast<float>(i), 0.0F, 0.0F);
    cloud.normals.emplace_back(0.0F, 0.0F, 1.0F);
  }
  far = cloud;
  for (auto& p : far.points) p.y() += 100.0F;
  const GicpResult result =
      refined(cloud, draw_balanced(cloud, 50), far, KdTree(far.points), Eigen::Isometry3d::Identity(), {{}});
  REQUIRE_FALSE(result.converged);
  REQUIRE(testing::difference(result.T_target_source, Eigen::Isometry3d::Identity()) == 0.0);
}

TEST_CASE("NormalEquations: the sums of the matrices", "[parts][property]") {
  Rng rng(47);
  const auto draw = [&] {
    return Eigen::Vector3d(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0));
  };
  // Less than a block, a block and more; with normals that are equal, apart, opposite and zero.
  for (const int count : {1, 7, 32, 33, 100}) {
    CAPTURE(count);
    constexpr double kSqScale = 0.03;
    NormalEquations equations(kSqScale);
    Matrix6d H = Matrix6d::Zero();
    Vector6d b = Vector6d::Zero();
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector3d d = 0.3 * draw(), y = 20.0 * draw();
      const Eigen::Vector3d n = i % 5 == 4 ? Eigen::Vector3d::Zero() : draw().normalized();
      Eigen::Vector3d m = n;
      if (i % 4 == 1) m = draw().normalized();
      if (i % 4 == 2) m = -n;
      if (i % 4 == 3) m.setZero();
      equations.add(d, y, n, m);
      Eigen::Matrix3d C = 2.0 * Eigen::Matrix3d::Identity();
      C -= (1.0 - kFlatness) * (n * n.transpose() + m * m.transpose());
      const Eigen::Matrix3d M = 2.0 * kFlatness * C.inverse();
      const double robust = kSqScale / (kSqScale + d.dot(M * d));
      Eigen::Matrix<double, 3, 6> J;
      J << Eigen::Matrix3d::Identity(), -se3::skew(y);
      H += robust * robust * J.transpose() * M * J;
      b += robust * robust * J.transpose() * M * d;
    }
    equations.finish();
    REQUIRE(equations.count() == static_cast<std::size_t>(count));
    REQUIRE((equations.H() - H).norm() < 1e-4 * H.norm());
    REQUIRE((equations.b() - b).norm() < 1e-4 * b.norm());
    REQUIRE(equations.H() == equations.H().transpose());
  }
}

TEST_CASE("most_similar: the most similar of all, as by comparing each with each", "[parts][property]") {
  Rng rng(41);
  for (const auto& [sources, targets] :
       std::vector<std::pair<int, int>>{{0, 5}, {5, 0}, {1, 1}, {3, 9}, {61, 50}}) {
    CAPTURE(sources, targets);
    const auto draw = [&](int count) {
      Descriptors d(kFpfhSize, count);
      for (Eigen::Index i = 0; i < d.size(); ++i) d.data()[i] = static_cast<float>(rng.uniform());
      if (count > 0) d.colwise().normalize();
      return d;
    };
    const Descriptors a = draw(sources), b = draw(targets);
    const auto matches = most_similar(PackedDescriptors(b), PackedDescriptors(a));
    REQUIRE(matches.size() == (targets == 0 ? 0U : static_cast<std::size_t>(sources)));
    const auto portable = most_similar(PackedDescriptors(b), PackedDescriptors(a), true);
    const auto same = [](const DescriptorMatch& m, const DescriptorMatch& p) {
      return m.source == p.source && m.target == p.target && m.similarity == p.similarity &&
             m.mutual == p.mutual;
    };
    REQUIRE(std::equal(matches.begin(), matches.end(), portable.begin(), portable.end(), same));
    for (const DescriptorMatch& m : matches) {
      const Eigen::VectorXf similar = b.transpose() * a.col(m.source);
      const Eigen::VectorXf back = a.transpose() * b.col(m.target);
      // Measured: the integers differ from the floats by at most 1.1e-4.
      REQUIRE(similar[m.target] > similar.maxCoeff() - 3e-4F);
      REQUIRE(std::abs(static_cast<float>(m.similarity) / 268435456.0F - similar[m.target]) < 3e-4F);
      if (m.mutual) REQUIRE(back[m.source] > back.maxCoeff() - 3e-4F);
      if (back[m.source] > 0.0F && (back.array() < back[m.source] - 3e-4F).count() == sources - 1) {
        REQUIRE(m.mutual);
      }
    }
  }
}

TEST_CASE("RangeImage: points in front of the seen surfaces contradict them, points on or behind do not",
          "[parts]") {
  Rng rng(43);
  // A sphere of 10 m around the sensor, but for a hole upwards.
  PointCloud shell;
  while (shell.points.size() < 20000) {
    const Eigen::Vector3f direction = random_direction(rng);
    if (direction.z() < 0.8F) shell.points.push_back(10.0F * direction);
  }
  const RangeImage image(shell);
  const auto scaled = [&](float factor) {
    PointCloud out = shell;
    for (Eigen::Vector3f& p : out.points) p *= factor;
    return out;
  };
  const Eigen::Isometry3d same = Eigen::Isometry3d::Identity();
  REQUIRE(image.contradiction(shell, same, 1000) == 0.0);
  REQUIRE(image.contradiction(scaled(1.5F), same, 1000) == 0.0);
  REQUIRE(image.contradiction(scaled(0.95F), same, 1000) == 0.0);  // within the margin
  REQUIRE(image.contradiction(scaled(0.6F), same, 1000) == 1.0);
  REQUIRE(image.contradiction(scaled(0.6F), Eigen::Isometry3d(Eigen::Translation3d(0, 0, 40)), 1000) == 0.0);
  REQUIRE(RangeImage(PointCloud{}).contradiction(shell, same, 1000) == 0.0);
  REQUIRE(image.contradiction(PointCloud{}, same, 1000) == 0.0);
}

TEST_CASE("fast_atan2: as std::atan2 in all directions, also of zeros", "[parts][differential]") {
  Rng rng(5);
  for (int i = 0; i < 20000; ++i) {
    const auto x = static_cast<float>(rng.normal() * std::pow(10.0, rng.uniform(-20.0, 20.0)));
    const auto y = static_cast<float>(x * std::tan(rng.uniform(-1.6, 1.6)));
    CAPTURE(x, y);
    REQUIRE(std::abs(fast_atan2(y, x) - std::atan2(y, x)) < 2e-5F);  // measured 1.2e-5
  }
  for (const float x : {-1.0F, -0.0F, 0.0F, 1.0F}) {
    for (const float y : {-1.0F, 0.0F, 1.0F}) {
      CAPTURE(x, y);
      if (x == 0.0F && y == 0.0F) {
        REQUIRE(fast_atan2(y, x) == 0.0F);
      } else {
        REQUIRE(std::abs(fast_atan2(y, x) - std::atan2(y, x)) < 2e-5F);
      }
    }
  }
}

TEST_CASE("refine_gicp: what is known from other iterations changes nothing", "[parts][property]") {
  Rng rng(47);
  FeatureOptions options;
  const testing::Scene scene(47);
  const ScanFeatures a = compute_features(*scene.scan(testing::ground_pose(0, 0, 0), 6000, rng), options);
  const ScanFeatures b =
      compute_features(*scene.scan(testing::ground_pose(0.4, 0.2, 0.1), 6000, rng), options);
  const auto order = draw_balanced(b.cloud, 3000);
  // Passes of one iteration each keep no match from the iteration before only if they are runs of their own.
  const GicpPass one{1.0, 0, 1, 1e-9, 1e-9};
  Eigen::Isometry3d apart = Eigen::Isometry3d::Identity();
  for (int i = 0; i < 6; ++i) apart = refined(b.cloud, order, a.cloud, a.tree, apart, {one}).T_target_source;
  GicpPass six = one;
  six.iterations = 6;
  const GicpResult together = refined(b.cloud, order, a.cloud, a.tree, Eigen::Isometry3d::Identity(), {six});
  REQUIRE(together.iterations == 6);
  REQUIRE(together.T_target_source.matrix() == apart.matrix());
  FollowedPoints followed(a.tree, order.size());
  for (const double start_m : {0.7, 0.0}) {  // what the first start found changes nothing either
    Eigen::Isometry3d start = Eigen::Isometry3d::Identity();
    start.translation().x() = start_m;
    const GicpResult after =
        refine_gicp(b.cloud, robust_centre(b.cloud.points), order, a.cloud, followed, start, {six});
    if (start_m == 0.0) REQUIRE(after.T_target_source.matrix() == apart.matrix());
  }
}

TEST_CASE("building blocks: the functions of FastRegistrar with their checks", "[parts][differential]") {
  Rng rng(48);
  const testing::Scene scene(48);
  const ScanFeatures target = compute_features(*scene.scan(testing::ground_pose(0, 0, 0), 6000, rng), {});
  const ScanFeatures source =
      compute_features(*scene.scan(testing::ground_pose(0.4, 0.2, 0.1), 6000, rng), {});
  std::vector<std::uint32_t> all(target.cloud.size());
  std::iota(all.begin(), all.end(), 0U);
  const FpfhOptions described;
  const Descriptors descriptors = fpfh(target.cloud, target.tree);
  REQUIRE(descriptors == compute_fpfh(target.cloud, target.tree, all, described.radius_m,
                                      static_cast<std::size_t>(described.max_neighbours)));
  const auto matches = match_descriptors(descriptors, fpfh(source.cloud, source.tree));
  const std::vector<Match> points = matched_points(target.cloud, source.cloud, matches);
  const ConsensusOptions agreed;
  const Consensus found = consensus(points);
  const Consensus same =
      find_consensus(points, agreed.tolerance_m, static_cast<std::size_t>(agreed.max_hypotheses));
  REQUIRE(found.hypotheses.size() == same.hypotheses.size());
  for (std::size_t i = 0; i < found.hypotheses.size(); ++i) {
    REQUIRE(found.hypotheses[i].T_target_source.matrix() == same.hypotheses[i].T_target_source.matrix());
  }
  const GicpOptions options;
  const GicpResult result = gicp(target.cloud, target.tree, source.cloud);
  REQUIRE(result.T_target_source.matrix() ==
          refined(source.cloud, draw_balanced(source.cloud, 2000), target.cloud, target.tree,
                  Eigen::Isometry3d::Identity(),
                  gicp_passes(options.coarse_reach_m, options.fine_reach_m, 300, 2000))
              .T_target_source.matrix());
  // The options' defaults are those of the registrar.
  const FastRegistrarOptions fast;
  REQUIRE(described.radius_m == fast.fpfh_radius_m);
  REQUIRE(described.max_neighbours == fast.fpfh_neighbours);
  REQUIRE(agreed.tolerance_m == fast.match_tolerance_m);
  REQUIRE(agreed.max_hypotheses == fast.hypotheses);
  REQUIRE(options.coarse_reach_m == fast.coarse_reach_m);
  REQUIRE(options.fine_reach_m == fast.fine_reach_m);
  REQUIRE(options.coarse_points == fast.coarse_points);
  REQUIRE(options.fine_points == fast.fine_points);
}

}  // namespace
}  // namespace loopwise::parts_test
