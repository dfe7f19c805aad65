// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/scan_signature.hpp>

#include <cmath>
#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

#include "testing.hpp"

namespace loopwise::scan_signature_test {
namespace {

/// What a sensor at `pose` sees of a street: its ground and two walls, both with gaps, within `range_m`.
PointCloud street_from(const Eigen::Isometry3d& pose, double range_m, std::uint64_t seed) {
  Rng rng(seed);
  PointCloud cloud;
  const Eigen::Isometry3d to_body = pose.inverse();
  while (cloud.size() < 5000) {
    const double x = pose.translation().x() + rng.uniform(-range_m, range_m);
    Eigen::Vector3d point(x, rng.uniform(-5.0, 5.0), 0.0);
    if (rng.uniform() < 0.6) {
      point.y() = rng.uniform() < 0.5 ? -5.0 : 5.0;
      point.z() = rng.uniform(0.0, 4.0);
      if (std::sin(0.37 * x) + std::sin(0.83 * x) > 0.5) continue;
    }
    cloud.points.push_back((to_body * point).cast<float>());
  }
  return cloud;
}

Eigen::Isometry3d at(double x, double yaw = 0.0) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() << x, 0.0, 1.0;
  pose.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, yaw));
  return pose;
}

}  // namespace

TEST_CASE("scan signature: overlap falls with the distance, whichever way round", "[features][overlap]") {
  const ScanSignature here(street_from(at(0.0), 30.0, 1));
  REQUIRE(predicted_overlap(here, here, Eigen::Isometry3d::Identity()) > 0.99);
  double before = 1.0;
  for (const double x : {0.0, 10.0, 20.0, 30.0, 45.0}) {
    CAPTURE(x);
    const Eigen::Isometry3d there = at(x, 0.8);
    const ScanSignature other(street_from(there, 30.0, 2));
    const Eigen::Isometry3d T = at(0.0).inverse() * there;
    const double overlap = predicted_overlap(here, other, T);
    REQUIRE(overlap == predicted_overlap(other, here, T.inverse()));
    REQUIRE(overlap <= before);
    REQUIRE(overlap > 0.8 * (1.0 - x / 60.0) - 0.05);  // the share of the street that both see
    REQUIRE(overlap < 1.1 * (1.0 - x / 60.0) + 0.05);
    before = overlap;
    // A wrong guess sees less.
    REQUIRE(predicted_overlap(here, other, T * at(0.0, 1.0)) < 0.8 * overlap);
  }
  REQUIRE(predicted_overlap(here, here, at(200.0)) == 0.0);
}

TEST_CASE("scan signature: voxels are as large as the surroundings are wide", "[features][overlap]") {
  REQUIRE(ScanSignature(street_from(at(0.0), 4.0, 1)).voxel_m() == Approx(0.4).margin(0.001));
  REQUIRE(ScanSignature(street_from(at(0.0), 30.0, 1)).voxel_m() == Approx(1.5).margin(0.15));
  REQUIRE(ScanSignature(street_from(at(0.0), 500.0, 1)).voxel_m() == Approx(3.0).epsilon(1e-6));
}

TEST_CASE("scan signature: at most 8 kB for any cloud", "[features][overlap][property]") {
  Rng rng(5);
  for (int round = 0; round < 200; ++round) {
    const double x = std::pow(10.0, rng.uniform(-3.0, 4.0)), y = std::pow(10.0, rng.uniform(-3.0, 4.0)),
                 z = std::pow(10.0, rng.uniform(-3.0, 4.0));
    PointCloud cloud;
    for (std::size_t i = 0; i < 1 + rng.below(20000); ++i) {
      cloud.points.emplace_back(rng.uniform(-x, x), rng.uniform(-y, y), rng.uniform(-z, z));
    }
    const ScanSignature signature(cloud);
    REQUIRE_FALSE(signature.empty());
    REQUIRE(signature.bytes() <= 8000);
    const double self = predicted_overlap(signature, signature, Eigen::Isometry3d::Identity());
    REQUIRE((self >= 0.9 && self <= 1.0));
  }
}

TEST_CASE("scan signature: invalid points are left out", "[features][overlap][error]") {
  const ScanSignature none;
  REQUIRE(none.empty());
  REQUIRE(ScanSignature(PointCloud()).empty());
  PointCloud cloud = street_from(at(0.0), 30.0, 1);
  const ScanSignature clean(cloud);
  REQUIRE(predicted_overlap(clean, none, Eigen::Isometry3d::Identity()) == 0.0);
  REQUIRE(predicted_overlap(none, clean, Eigen::Isometry3d::Identity()) == 0.0);
  constexpr float kInf = std::numeric_limits<float>::infinity();
  for (const float bad : {std::nanf(""), kInf, -kInf, 1e30F, -1e30F}) {
    for (int k = 0; k < 50; ++k) {
      cloud.points.emplace_back(bad, 1.0F, 1.0F);
      cloud.points.emplace_back(1.0F, bad, 1.0F);
      cloud.points.emplace_back(1.0F, 1.0F, bad);
    }
  }
  REQUIRE(predicted_overlap(clean, ScanSignature(cloud), Eigen::Isometry3d::Identity()) > 0.9);
  PointCloud only_bad;
  only_bad.points.assign(10, Eigen::Vector3f::Constant(kInf));
  REQUIRE(ScanSignature(only_bad).empty());
  // Guesses far out of all maps are no overlap.
  REQUIRE(predicted_overlap(clean, clean, at(1e30)) == 0.0);
  REQUIRE(predicted_overlap(clean, clean, at(std::nan(""))) == 0.0);
}

TEST_CASE("scan signature: as words and back", "[features][overlap]") {
  const ScanSignature a(street_from(at(0.0), 30.0, 1)), b(street_from(at(7.0), 30.0, 2));
  const ScanSignature again = ScanSignature::from_words(a.words());
  REQUIRE(again.words() == a.words());
  REQUIRE(again.voxel_m() == a.voxel_m());
  REQUIRE(predicted_overlap(again, b, at(7.0)) == predicted_overlap(a, b, at(7.0)));
  REQUIRE(ScanSignature::from_words({}).empty());
  REQUIRE(ScanSignature().words().empty());

  // Any altered bytes are refused or usable.
  Rng rng(3);
  for (int round = 0; round < 2000; ++round) {
    std::vector<std::uint32_t> words = a.words();
    if (rng.uniform() < 0.3) words.resize(rng.below(words.size()));
    const std::size_t head = std::min<std::size_t>(words.size(), 10);
    if (head > 0) words[rng.below(head)] = static_cast<std::uint32_t>(rng());
    try {
      const double overlap = predicted_overlap(ScanSignature::from_words(words), b, at(7.0));
      REQUIRE((overlap >= 0.0 && overlap <= 1.0));
    } catch (const InputError&) {
    }
  }
}

}  // namespace loopwise::scan_signature_test
