// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/place.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

#include "testing.hpp"

namespace loopwise {
namespace {

Eigen::Isometry3d pose(double x, double y, double z, double yaw) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = se3::so3_exp({0.0, 0.0, yaw});
  T.translation() << x, y, z;
  return T;
}

/// A site of boxes and poles around the origin, drawn from a seed, as seen from a level pose.
PointCloud site(std::uint64_t seed, const Eigen::Isometry3d& T_site_level, std::uint64_t noise_seed = 1) {
  Rng rng(seed), noise(noise_seed);
  PointCloud cloud;
  const Eigen::Isometry3d to_level = T_site_level.inverse();
  const auto add = [&](double x, double y, double z) {
    const Eigen::Vector3d p(x + noise.normal(0.0, 0.02), y + noise.normal(0.0, 0.02), z);
    cloud.points.push_back((to_level * p).cast<float>());
  };
  for (int wall = 0; wall < 14; ++wall) {
    const double x = rng.uniform(-30.0, 30.0), y = rng.uniform(-30.0, 30.0), turn = rng.uniform(0.0, 3.1);
    const double length = rng.uniform(3.0, 12.0), height = rng.uniform(1.5, 5.0);
    for (double s = 0.0; s < length; s += 0.2) {
      for (double z = 0.0; z < height; z += 0.3) add(x + s * std::cos(turn), y + s * std::sin(turn), z);
    }
  }
  for (int pole = 0; pole < 15; ++pole) {
    const double x = rng.uniform(-25.0, 25.0), y = rng.uniform(-25.0, 25.0);
    for (double z = 0.0; z < 4.0; z += 0.1) add(x, y, z);
  }
  for (double x = -30.0; x < 30.0; x += 1.0) {
    for (double y = -30.0; y < 30.0; y += 1.0) add(x, y, 0.0);
  }
  return cloud;
}

double yaw_of(const Eigen::Isometry3d& T) {
  return se3::so3_log(T.linear()).z();
}

constexpr std::uint64_t kSites = 30;

}  // namespace

TEST_CASE("places: level frames keep the yaw and lose the tilt", "[features][place]") {
  Rng rng(3);
  for (int trial = 0; trial < 20; ++trial) {
    const Eigen::Isometry3d upright = pose(1.0, 2.0, 3.0, rng.uniform(-3.0, 3.0));
    Eigen::Isometry3d tilted = upright;
    tilted.linear() = upright.linear() * se3::so3_exp({rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), 0.0});
    const Eigen::Matrix3d R = level_rotation(tilted);
    REQUIRE((R - upright.linear().transpose() * tilted.linear()).cwiseAbs().maxCoeff() < 1e-12);
    PointCloud cloud;
    cloud.points.emplace_back(1.0F, 2.0F, 3.0F);
    const Eigen::Vector3d up = tilted.linear() * Eigen::Vector3d(1.0, 2.0, 3.0);
    REQUIRE(level_cloud(cloud, tilted).points[0].z() == Approx(up.z()));
  }
}

TEST_CASE("places: a match between bodies is the one between their level frames", "[features][place]") {
  const Eigen::Matrix3d tilt_a = se3::so3_exp({0.2, -0.1, 0.0}), tilt_b = se3::so3_exp({-0.3, 0.2, 0.0});
  PlaceMatch match;
  match.T_query_match = pose(3.0, -2.0, 0.5, 1.0);
  match.covariance.diagonal() << 1.0, 4.0, 0.1, 0.01, 0.01, 0.2;
  const PlaceMatch bodies = between_bodies(match, tilt_a, tilt_b);
  const Eigen::Vector3d in_b(1.0, 2.0, 3.0);
  const Eigen::Vector3d in_a = tilt_a.transpose() * (match.T_query_match * (tilt_b * in_b));
  REQUIRE((bodies.T_query_match * in_b - in_a).norm() < 1e-12);
  // To first order, what moves the level frame moves the body alike.
  const Vector6d xi = Vector6d::Constant(1e-6);
  PlaceMatch moved = match;
  moved.T_query_match = match.T_query_match * se3::exp(xi);
  const Vector6d seen =
      se3::log(bodies.T_query_match.inverse() * between_bodies(moved, tilt_a, tilt_b).T_query_match);
  REQUIRE(seen.dot(bodies.covariance.inverse() * seen) ==
          Approx(xi.dot(match.covariance.inverse() * xi)).epsilon(1e-3));
}

TEST_CASE("places: databases find a place again, turned", "[features][place]") {
  const std::unique_ptr<PlaceDatabase> places = make_scan_context_database();
  for (std::uint64_t s = 0; s < kSites; ++s) places->add(100 + s, site(s, pose(0.0, 0.0, 1.0, 0.0)));
  REQUIRE(places->size() == kSites);
  for (std::uint64_t s = 0; s < kSites; ++s) {
    CAPTURE(s);
    const Eigen::Isometry3d there = pose(0.4, -0.3, 1.4, 0.2 * static_cast<double>(s) - 3.0);
    const auto matches = places->query(site(s, there, 2), 3);
    REQUIRE(matches.size() == 3);
    REQUIRE(matches[0].key == 100 + s);
    REQUIRE(matches[0].similarity > matches[1].similarity);
    REQUIRE(matches[0].similarity <= 1.0);
    const Vector6d error =
        se3::log(matches[0].T_query_match.inverse() * there.inverse() * pose(0.0, 0.0, 1.0, 0.0));
    REQUIRE(error.dot(matches[0].covariance.inverse() * error) < 16.8);  // 99 % of a χ² of 6
    REQUIRE(std::abs(yaw_of(matches[0].T_query_match) + yaw_of(there)) < 0.12);
  }
}

TEST_CASE("places: filters, keys and clouds that show nothing", "[features][place]") {
  const std::unique_ptr<PlaceDatabase> places = make_scan_context_database();
  for (std::uint64_t s = 0; s < 5; ++s) places->add(s, site(s, pose(0.0, 0.0, 1.0, 0.0)));
  for (const PlaceMatch& match : places->query(2, 5)) REQUIRE(match.key != 2);
  for (const PlaceMatch& match : places->query(2, 5, [](Key key) { return key > 3; }))
    REQUIRE(match.key == 4);
  REQUIRE(places->query(2, 0).empty());
  REQUIRE(places->query(PointCloud{}, 5).empty());
  places->add(50, PointCloud{});
  for (const PlaceMatch& match : places->query(2, 10)) REQUIRE(match.key != 50);
  REQUIRE_THROWS_WITH(places->add(2, PointCloud{}), "place 2 was added before");
  REQUIRE_THROWS_WITH(places->query(99, 1), "place 99 is not in the database");
  REQUIRE(places->find(99) == nullptr);
  ScanContextOptions options;
  options.rings = 1;
  REQUIRE_THROWS_AS(make_scan_context_database(options), OptionError);
}

}  // namespace loopwise
