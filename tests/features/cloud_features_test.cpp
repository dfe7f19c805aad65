// SPDX-License-Identifier: BSD-3-Clause
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/features/normals.hpp>
#include <loopwise/features/observability.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include "testing.hpp"

namespace loopwise::cloud_features_test {
namespace {

PointCloud random_cloud(Rng& rng, std::size_t count, double extent_m) {
  PointCloud cloud;
  for (std::size_t i = 0; i < count; ++i) {
    const auto u = [&] { return static_cast<float>(rng.uniform(-extent_m, extent_m)); };
    cloud.points.emplace_back(u(), u(), u());
  }
  return cloud;
}

/// Points on the inside of a box around the sensor, or on a part of its faces.
PointCloud room(Rng& rng, std::size_t count, int faces = 6) {
  const Eigen::Vector3d half(8.0, 5.0, 2.0);
  PointCloud cloud;
  for (std::size_t i = 0; i < count; ++i) {
    const int face = static_cast<int>(i) % faces;
    const Eigen::Index axis = face / 2;
    Eigen::Vector3d p(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0));
    p = p.cwiseProduct(half);
    p[axis] = face % 2 == 0 ? half[axis] : -half[axis];
    cloud.points.push_back(p.cast<float>());
  }
  return cloud;
}

TEST_CASE("range: points too far from the sensor are left out and counted", "[features]") {
  Rng rng(8);
  PointCloud cloud = room(rng, 3000);
  const ScanFeatures clean = compute_features(cloud, {});
  REQUIRE(clean.far_points == 0);
  for (int i = 0; i < 60; ++i) cloud.points.emplace_back(1e6F, 0.0F, 9e6F);
  const ScanFeatures features = compute_features(cloud, {});
  REQUIRE(features.far_points == 60);
  REQUIRE(features.cloud.points == clean.cloud.points);
  REQUIRE(features.observability.min_eigenvalue == clean.observability.min_eigenvalue);

  FeatureOptions all;
  all.max_range_m = 0.0;
  REQUIRE(compute_features(cloud, all).far_points == 0);
  FeatureOptions near;
  near.max_range_m = 7.0;
  for (const Eigen::Vector3f& p : compute_features(cloud, near).cloud.points) REQUIRE(p.norm() <= 7.0F);

  // In world coordinates the range is that from the middle.
  for (Eigen::Vector3f& p : cloud.points) p.x() += 5000.0F;
  REQUIRE(compute_features(cloud, {}).far_points == 60);
}

TEST_CASE("range: of a scan that looks one way the points at the sensor stay", "[features]") {
  PointCloud ahead;  // points from 1 to 31 m, and one that is infinitely far away
  for (int i = 0; i < 600; ++i) {
    ahead.points.emplace_back(1.0F + 0.05F * static_cast<float>(i), 0.01F * static_cast<float>(i % 7), 0.0F);
  }
  ahead.points.emplace_back(std::numeric_limits<float>::infinity(), 0.0F, 0.0F);
  constexpr double kRangeM = 10.0;  // less than the middle of the points is away
  REQUIRE(points_beyond(ahead, kRangeM) == 420);
  for (const Eigen::Vector3f& p : within_range(ahead, kRangeM).points) {
    REQUIRE((!p.allFinite() || p.norm() < 10.001F));
  }
  REQUIRE(within_range(ahead, kRangeM).size() == 181);
}

TEST_CASE("range: the cache reports each scan once", "[features]") {
  Rng rng(9);
  auto stray = std::make_shared<PointCloud>(room(rng, 2000));
  stray->points.emplace_back(9e6F, 0.0F, 0.0F);
  const auto clean = std::make_shared<const PointCloud>(room(rng, 2000));
  FeatureOptions options;
  options.max_cache_mb = 0.0;
  FeatureCache cache([&](Key key) { return key == 2 ? clean : stray; }, options);
  for (const Key key : {3, 2, 1, 3}) static_cast<void>(cache.get(key));
  const Problems problems = cache.problems();
  REQUIRE(problems.count("point too far from the sensor left out") == 2);
  REQUIRE_THAT(problems.all()[0].example, Contains("scan 1: ") && Contains("features.max_range_m"));
}

TEST_CASE("voxel filter: one mean point a cube, in the order of the first points", "[voxel][differential]") {
  Rng rng(3);
  PointCloud cloud = random_cloud(rng, 3000, 3.0);
  for (std::size_t i = 0; i < cloud.size(); ++i) cloud.intensities.push_back(static_cast<float>(i));
  const double voxel_m = 0.5;

  std::map<std::tuple<int, int, int>, std::pair<std::size_t, std::vector<std::size_t>>> cubes;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const Eigen::Vector3i c = (cloud.points[i].cast<double>() / voxel_m).array().floor().cast<int>();
    auto& cube = cubes.try_emplace({c.x(), c.y(), c.z()}, i, std::vector<std::size_t>()).first->second;
    cube.second.push_back(i);
  }
  std::map<std::size_t, std::vector<std::size_t>> in_order;
  for (const auto& entry : cubes) in_order[entry.second.first] = entry.second.second;

  const PointCloud out = voxel_downsample(cloud, voxel_m);
  REQUIRE(out.size() == in_order.size());
  REQUIRE(out.intensities.size() == out.size());
  std::size_t i = 0;
  for (const auto& entry : in_order) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    double intensity = 0.0;
    for (const std::size_t member : entry.second) {
      mean += cloud.points[member].cast<double>();
      intensity += static_cast<double>(member);
    }
    const auto n = static_cast<double>(entry.second.size());
    REQUIRE((out.points[i].cast<double>() - mean / n).norm() < 1e-6);  // measured 2e-7: the rounding to float
    REQUIRE(static_cast<double>(out.intensities[i]) == Approx(intensity / n));
    ++i;
  }
}

TEST_CASE("voxel filter: clouds of other types have the same mean points", "[voxel][differential]") {
  Rng rng(4);
  PointCloud cloud = random_cloud(rng, 3000, 3.0);
  std::vector<Eigen::Vector3d> wide;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    if (i % 50 == 0) cloud.points[i].y() = std::numeric_limits<float>::quiet_NaN();
    wide.push_back(cloud.points[i].cast<double>());
  }
  const PointCloud out = voxel_downsample(wide, 0.5);
  REQUIRE(out.points == voxel_downsample(cloud, 0.5).points);
  REQUIRE(out.points == voxel_downsample(cloud.points, 0.5).points);
  REQUIRE(out.origin.isZero(0.0));

  // Means of digits that a float does not have, relative to an origin of whole metres.
  const Eigen::Vector3d offset(5e5, -4e6, 100.0);
  for (Eigen::Vector3d& p : wide) p += offset;
  const PointCloud world = voxel_downsample(wide, 0.5);
  REQUIRE(world.size() == out.size());
  REQUIRE(world.origin == Eigen::Vector3d(world.origin.array().round()));
  for (std::size_t i = 0; i < out.size(); ++i) {
    const Eigen::Vector3d p = world.origin + world.points[i].cast<double>() - offset;
    REQUIRE((p - out.points[i].cast<double>()).norm() < 1e-5);
  }
}

TEST_CASE("voxel filter: a cloud sparser than the grid stays as it is", "[voxel]") {
  PointCloud cloud;
  for (int i = 0; i < 600; ++i) cloud.points.emplace_back(static_cast<float>(600 - i), 0.3F, -0.7F);
  REQUIRE(voxel_downsample(cloud, 0.5).points == cloud.points);
}

TEST_CASE("voxel filter: averaged normals are unit vectors, opposite ones unknown", "[voxel]") {
  PointCloud cloud;
  cloud.points = {{0.1F, 0, 0}, {0.2F, 0, 0}, {5.1F, 0, 0}, {5.2F, 0, 0}};
  cloud.normals = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, -1}};
  const PointCloud out = voxel_downsample(cloud, 1.0);
  REQUIRE(out.size() == 2);
  REQUIRE((out.normals[0] - Eigen::Vector3f(1, 1, 0).normalized()).norm() < 1e-6F);
  REQUIRE(out.normals[1].isZero());
}

TEST_CASE("voxel filter: bad edges are refused, bad points left out, far points survive", "[voxel][error]") {
  REQUIRE_THROWS_WITH(voxel_downsample({}, 0.0), "voxel_m = 0, must be > 0");
  REQUIRE_THROWS_AS(voxel_downsample({}, std::numeric_limits<double>::quiet_NaN()), OptionError);
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  PointCloud cloud;
  cloud.points = {{nan, 0, 0}, {1e5F, -1e5F, 1e5F}, {0, inf, 0}, {3e38F, -3e38F, 0}};
  REQUIRE(voxel_downsample(cloud, 0.5).size() == 2);
  REQUIRE(adaptive_downsample(cloud, 0.5, 100).size() == 2);
}

TEST_CASE("adaptive filter: keeps sparse scans and refines the grid for small places", "[voxel]") {
  Rng rng(5);
  const PointCloud sparse = random_cloud(rng, 600, 20.0);
  REQUIRE(adaptive_downsample(sparse, 5.0, 1000).points == sparse.points);
  const PointCloud narrow = random_cloud(rng, 20000, 1.0);
  REQUIRE(voxel_downsample(narrow, 0.5).size() == 64);
  REQUIRE(adaptive_downsample(narrow, 0.5, 400).points == voxel_downsample(narrow, 0.25).points);
}

TEST_CASE("normals: planes, turned towards the sensor", "[normals]") {
  Rng rng(7);
  const PointCloud cloud = room(rng, 6000);
  const auto normals = estimate_normals(cloud.points, KdTree(cloud.points), 10);
  std::size_t exact = 0;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    REQUIRE(std::abs(normals[i].norm() - 1.0F) < 1e-5F);
    REQUIRE(normals[i].dot(cloud.points[i]) <= 0.0F);
    if (normals[i].cwiseAbs().maxCoeff() > 1.0F - 1e-4F) ++exact;
  }
  // Neighbours round an edge belong to two faces; measured 4886 of 6000 exact.
  REQUIRE(exact > 4500);
}

TEST_CASE("normals: unknown where neighbours are few, equal or on a line", "[normals][error]") {
  const auto normals_of = [](const std::vector<Eigen::Vector3f>& points) {
    return estimate_normals(points, KdTree(points), 5);
  };
  for (std::size_t n : {0u, 1u, 2u}) {
    const auto normals = normals_of(std::vector<Eigen::Vector3f>(n, {1, 2, 3}));
    REQUIRE(normals == std::vector<Eigen::Vector3f>(n, Eigen::Vector3f::Zero()));
  }
  std::vector<Eigen::Vector3f> equal(50, {1e5F, 2, 3}), line;
  for (int i = 0; i < 50; ++i) line.emplace_back(static_cast<float>(i), 2.0F * static_cast<float>(i), 3.0F);
  for (const auto& points : {equal, line}) {
    for (const auto& normal : normals_of(points)) REQUIRE(normal.isZero());
  }
  REQUIRE_THROWS_AS(estimate_normals(equal, KdTree(equal), 2), OptionError);
}

TEST_CASE("observability: the matrix is the sum over points, about the sensor",
          "[observability][differential]") {
  Rng rng(11);
  PointCloud cloud = random_cloud(rng, 500, 10.0);
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    cloud.normals.push_back(
        Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized().cast<float>());
  }
  Matrix6d expected = Matrix6d::Zero();
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    Eigen::Matrix<double, 1, 6> H;
    const Eigen::Vector3d p = cloud.points[i].cast<double>(), n = cloud.normals[i].cast<double>();
    H << p.y() * n.z() - p.z() * n.y(), p.z() * n.x() - p.x() * n.z(), p.x() * n.y() - p.y() * n.x(), n.x(),
        n.y(), n.z();
    expected += H.transpose() * H;
  }
  REQUIRE((observability_matrix(cloud) - expected).cwiseAbs().maxCoeff() < 1e-9);
  const Observability figures = observability(cloud);
  REQUIRE(figures.min_eigenvalue ==
          Approx(Eigen::SelfAdjointEigenSolver<Matrix6d>(expected).eigenvalues()[0]).epsilon(1e-9));
  // Uniform directions: Σ n nᵀ / N is a third of the identity.
  REQUIRE(figures.min_eigenvalue_lamp == Approx(1.0 / 3.0).margin(0.04));  // measured 0.306
}

TEST_CASE("observability: a corridor is worse than a room, a plane has none", "[observability]") {
  Rng rng(13);
  const auto figures = [&](int faces) {
    FeatureOptions options;
    options.min_points = 10000;
    return compute_features(room(rng, 3000, faces), options).observability;
  };
  // Faces come in pairs along x, y, z: 6 is a room, 4 lacks floor and ceiling, 2 leaves two parallel walls.
  const Observability closed = figures(6), open = figures(4), walls = figures(2);
  REQUIRE(closed.min_eigenvalue > 100.0 * std::max(1.0, walls.min_eigenvalue));  // measured 982 and 0
  REQUIRE(closed.min_eigenvalue > 10.0 * open.min_eigenvalue);                   // measured 5.8
  REQUIRE(closed.min_eigenvalue_lamp > 0.2);
  REQUIRE(walls.min_eigenvalue_lamp < 1e-6);
}

TEST_CASE("observability: rotating the scan changes nothing", "[observability][property]") {
  Rng rng(17);
  FeatureOptions options;
  options.min_points = 10000;
  const PointCloud cloud = compute_features(room(rng, 3000), options).cloud;
  PointCloud turned = cloud;
  const Eigen::Matrix3f R = se3::so3_exp({0.3, -1.2, 2.0}).cast<float>();
  for (auto& p : turned.points) p = R * p;
  for (auto& n : turned.normals) n = R * n;
  const Observability a = observability(cloud), b = observability(turned);
  REQUIRE(b.min_eigenvalue == Approx(a.min_eigenvalue).epsilon(1e-5));  // measured 2e-8: rounding to float
  REQUIRE(b.min_eigenvalue_lamp == Approx(a.min_eigenvalue_lamp).epsilon(1e-5));
}

TEST_CASE("features: degenerate scans give finite features", "[features][error]") {
  Rng rng(19);
  std::vector<PointCloud> clouds(3);
  clouds[1].points = {{1, 2, 3}};
  clouds[2] = random_cloud(rng, 5, 1.0);
  PointCloud equal, line, plane, far = random_cloud(rng, 3000, 5.0);
  for (int i = 0; i < 2000; ++i) {
    equal.points.emplace_back(1.0F, 1.0F, 1.0F);
    line.points.emplace_back(0.01F * static_cast<float>(i), 0.0F, 2.0F);
    plane.points.emplace_back(static_cast<float>(rng.uniform(-9, 9)), static_cast<float>(rng.uniform(-9, 9)),
                              -1.0F);
  }
  for (auto& p : far.points) p += Eigen::Vector3f(1e5F, 1e5F, 0.0F);
  clouds.insert(clouds.end(), {equal, line, plane, far});
  for (const PointCloud& cloud : clouds) {
    const ScanFeatures features = compute_features(cloud, {});
    REQUIRE(features.raw_points == cloud.size());
    REQUIRE(features.cloud.normals.size() == features.cloud.size());
    for (const auto& n : features.cloud.normals) REQUIRE(n.allFinite());
    REQUIRE(std::isfinite(features.observability.min_eigenvalue));
    REQUIRE(std::isfinite(features.observability.min_eigenvalue_lamp));
    REQUIRE(features.observability.min_eigenvalue >= 0.0);
  }
}

TEST_CASE("features: normals of a file are kept, or estimated on request; bad ones are unknown",
          "[features]") {
  PointCloud cloud;
  for (int i = 0; i < 30; ++i) {
    const int row = i / 6;
    cloud.points.emplace_back(static_cast<float>(i % 6), static_cast<float>(row), -1.0F);
  }
  cloud.normals.assign(30, {0, 3, 4});
  cloud.normals[7] = {std::numeric_limits<float>::quiet_NaN(), 0, 0};
  FeatureOptions options;
  const ScanFeatures kept = compute_features(cloud, options);
  REQUIRE((kept.cloud.normals[0] - Eigen::Vector3f(0, 0.6F, 0.8F)).norm() < 1e-6F);
  REQUIRE(kept.cloud.normals[7].isZero());
  options.use_file_normals = false;
  REQUIRE((compute_features(cloud, options).cloud.normals[0] - Eigen::Vector3f::UnitZ()).norm() < 1e-5F);
}

}  // namespace
}  // namespace loopwise::cloud_features_test
