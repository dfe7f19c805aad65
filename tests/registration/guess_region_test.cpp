// SPDX-License-Identifier: BSD-3-Clause
#include "guess_region.hpp"

#include <loopwise/core/se3.hpp>

#include "testing.hpp"

namespace loopwise::guess_region_test {
namespace {

/// A task with a guess, and a pose at an offset from it in the frame of the target.
struct GuessedTask {
  RegistrationTask task = pair_task(1, 0, 1);
  FastRegistrarOptions options;

  explicit GuessedTask(std::uint64_t seed) {
    Rng rng(seed);
    Vector6d xi;
    for (Eigen::Index i = 0; i < 6; ++i) xi[i] = rng.uniform(-3.0, 3.0);
    task.guess_from_to = se3::exp(xi);
    options.tests.max_translation_m = 20.0;  // 10 m are near
  }
  [[nodiscard]] Eigen::Isometry3d at(const Eigen::Vector3d& offset) const {
    Eigen::Isometry3d T_from_to = *task.guess_from_to;
    T_from_to.translation() += T_from_to.linear() * offset;
    return T_from_to.inverse();
  }
  [[nodiscard]] GuessRegion region() const { return {task, options}; }
};

TEST_CASE("GuessRegion: without a guess, its covariance or guess_sigmas it contains all", "[parts]") {
  GuessedTask guessed(1);
  const Eigen::Isometry3d far = guessed.at({300.0, 0.0, 40.0});
  const auto contains_all = [&] {
    const GuessRegion region = guessed.region();
    return !region.is_known() && region.contains(far);
  };
  REQUIRE(contains_all());
  guessed.task.guess_covariance = 0.01 * Matrix6d::Identity();
  REQUIRE(guessed.region().is_known());
  REQUIRE_FALSE(guessed.region().contains(far));
  guessed.options.guess_sigmas = 0.0;
  REQUIRE(contains_all());
  guessed.options.guess_sigmas = 5.0;
  guessed.task.guess_from_to.reset();
  REQUIRE(contains_all());
}

TEST_CASE("GuessRegion: near the guess all poses, farther as many deviations as guess_sigmas", "[parts]") {
  GuessedTask guessed(GENERATE(2u, 3u, 4u));
  guessed.options.guess_sigmas = 4.0;
  Matrix6d covariance = Matrix6d::Identity();
  covariance.diagonal().head<3>() << 9.0 - 0.16, 0.0, 1.0 - 0.16;  // the error of a start is added
  guessed.task.guess_covariance = covariance;
  const GuessRegion region = guessed.region();
  REQUIRE(region.is_known());
  const auto contains = [&](double x, double y, double z) { return region.contains(guessed.at({x, y, z})); };
  // Near: 10 m, and 2.5 m of height.
  REQUIRE(region.is_near(guessed.at({0.0, 9.9, 1.0})));
  REQUIRE(contains(0.0, 9.9, 1.0));
  REQUIRE_FALSE(region.is_near(guessed.at({0.0, 1.0, 2.6})));
  // Four deviations of 3 m along x, of 1 m in height, and of 0.4 m along y.
  REQUIRE(contains(11.9, 0.0, 0.0));
  REQUIRE_FALSE(contains(12.1, 0.0, 0.0));
  REQUIRE(contains(0.0, 0.0, 3.9));
  REQUIRE_FALSE(contains(0.0, 0.0, 4.1));
  REQUIRE_FALSE(contains(10.1, 1.0, 0.0));
  REQUIRE_FALSE(contains(0.0, 10.1, 0.0));
}

TEST_CASE("GuessRegion: a covariance that is not positive definite excludes nothing", "[parts]") {
  GuessedTask guessed(6);
  Matrix6d covariance = Matrix6d::Identity();
  covariance(0, 0) = -2.0;
  guessed.task.guess_covariance = covariance;
  REQUIRE(guessed.region().contains(guessed.at({0.0, 40.0, 0.0})));
}

}  // namespace
}  // namespace loopwise::guess_region_test
