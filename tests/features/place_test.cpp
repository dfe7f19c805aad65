// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/place.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

#include "place_site.hpp"
#include "testing.hpp"

namespace loopwise::place_test {
namespace {

constexpr auto pose = testing::level_pose;
using testing::site;

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
  // To first order, a motion of the level frame moves the body equally.
  const Vector6d xi = Vector6d::Constant(1e-6);
  PlaceMatch moved = match;
  moved.T_query_match = match.T_query_match * se3::exp(xi);
  const Vector6d seen =
      se3::log(bodies.T_query_match.inverse() * between_bodies(moved, tilt_a, tilt_b).T_query_match);
  REQUIRE(seen.dot(bodies.covariance.inverse() * seen) ==
          Approx(xi.dot(match.covariance.inverse() * xi)).epsilon(1e-3));
}

TEST_CASE("places: databases find a place again, turned", "[features][place]") {
  const bool density = GENERATE(false, true);
  CAPTURE(density);
  const auto places = density ? make_density_place_database() : make_scan_context_database();
  for (std::uint64_t s = 0; s < kSites; ++s) places->add(100 + s, site(s, pose(0.0, 0.0, 1.0, 0.0)));
  REQUIRE(places->size() == kSites);
  for (std::uint64_t s = 0; s < kSites; ++s) {
    CAPTURE(s);
    const Eigen::Isometry3d there = pose(0.4, -0.3, 1.4, 0.2 * static_cast<double>(s) - 3.0);
    const auto matches = places->query(site(s, there, 2), 3);
    REQUIRE_FALSE(matches.empty());
    REQUIRE(matches[0].key == 100 + s);
    for (std::size_t i = 1; i < matches.size(); ++i)
      REQUIRE(matches[0].similarity > 1.1 * matches[i].similarity);
    REQUIRE(matches[0].similarity <= 1.0);
    const Vector6d error =
        se3::log(matches[0].T_query_match.inverse() * there.inverse() * pose(0.0, 0.0, 1.0, 0.0));
    REQUIRE(error.dot(matches[0].covariance.inverse() * error) < 16.8);  // 99 % of a χ² of 6
    REQUIRE(std::abs(yaw_of(matches[0].T_query_match) + yaw_of(there)) < 0.12);
  }
}

TEST_CASE(
    "places: density images give the pose, from another side, metres away and with fewer visible points",
    "[features][place]") {
  const auto places = make_density_place_database();
  for (std::uint64_t s = 0; s < kSites; ++s) places->add(s, site(s, pose(0.0, 0.0, 1.0, 0.0)));
  std::size_t found = 0;
  double worst_m = 0.0, worst_rad = 0.0;
  for (std::uint64_t s = 0; s < kSites; ++s) {
    CAPTURE(s);
    const Eigen::Isometry3d there = pose(7.0, -4.0, 1.8, 0.21 * static_cast<double>(s) - 3.0);
    const auto matches = places->query(site(s, there, 2, 30.0), 1);
    if (matches.empty() || matches[0].key != s) continue;
    ++found;
    const Eigen::Isometry3d error =
        matches[0].T_query_match.inverse() * there.inverse() * pose(0.0, 0.0, 1.0, 0.0);
    worst_m = std::max(worst_m, error.translation().head<2>().norm());
    worst_rad = std::max(worst_rad, std::abs(yaw_of(error)));
  }
  CAPTURE(found, worst_m, worst_rad);
  REQUIRE(found >= kSites - 2);
  REQUIRE(worst_m < 0.7);
  REQUIRE(worst_rad < 0.05);
}

TEST_CASE("places: self-similar surroundings are no places", "[features][place]") {
  // Poles on a grid look alike everywhere: the same grid elsewhere must not be found with confidence.
  const auto grid = [](double shift) {
    PointCloud cloud;
    for (double x = -28.0; x < 28.0; x += 4.0) {
      for (double y = -28.0; y < 28.0; y += 4.0) {
        for (double z = 0.0; z < 3.0; z += 0.1) {
          cloud.points.emplace_back(static_cast<float>(x + shift), static_cast<float>(y),
                                    static_cast<float>(z));
        }
      }
    }
    return cloud;
  };
  const auto places = make_density_place_database();
  places->add(1, grid(0.0));
  double similarity = 0.0;
  for (const PlaceMatch& match : places->query(grid(1.3), 5)) {
    similarity = std::max(similarity, match.similarity);
  }
  REQUIRE(similarity < 0.3);
}

TEST_CASE("places: results depend neither on earlier queries nor on the keys of other places",
          "[features][place][property]") {
  const auto forward = make_density_place_database(), again = make_density_place_database();
  for (std::uint64_t s = 0; s < 8; ++s) {
    forward->add(s, site(s, pose(0.0, 0.0, 1.0, 0.0)));
    again->add(1000 + s, site(s, pose(0.0, 0.0, 1.0, 0.0)));
    static_cast<void>(forward->query(s, 3));
  }
  for (std::uint64_t s = 0; s < 8; ++s) {
    const PointCloud seen = site(s, pose(2.0, 1.0, 1.0, 0.7), 3);
    const auto a = forward->query(seen, 3), b = again->query(seen, 3);
    REQUIRE(a.size() == b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      REQUIRE(a[i].key + 1000 == b[i].key);
      REQUIRE(a[i].similarity == b[i].similarity);
      REQUIRE(a[i].T_query_match.matrix() == b[i].T_query_match.matrix());
    }
  }
}

TEST_CASE("places: filters, keys and clouds that show nothing", "[features][place]") {
  const bool density = GENERATE(false, true);
  CAPTURE(density);
  const auto places = density ? make_density_place_database() : make_scan_context_database();
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
  DensityPlaceOptions fine;
  fine.cell_m = 0.01;
  REQUIRE_THROWS_WITH(make_density_place_database(fine), Contains("range_m"));
  const auto other = density ? make_scan_context_database() : make_density_place_database();
  REQUIRE_THROWS_AS(places->search(*other->describe(PointCloud{}), 1, {}), InputError);
}

}  // namespace loopwise::place_test
