// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Rooms that look the same from several places: how often a wrong pose is verified with too small a
/// covariance.
#include "registration_symmetric.hpp"

#include <cstdio>
#include <map>
#include <string>

#include <Eigen/Cholesky>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/fast_registrar.hpp>

#include "registration_pcl.hpp"
#include "rooms.hpp"

namespace loopwise::bench {
namespace {

constexpr double kChiSquare999 = 22.46;  // of six degrees of freedom

struct Counts {
  int pairs = 0, verified = 0, right = 0, confident_wrong = 0, ambiguous = 0;
  double ms = 0.0;
  void add(const Counts& other) {
    pairs += other.pairs;
    verified += other.verified;
    right += other.right;
    confident_wrong += other.confident_wrong;
    ambiguous += other.ambiguous;
    ms += other.ms;
  }
  void print(const char* kind, const char* guess) const {
    std::printf("%-12s %-8s %6d %9d %6d %16d %10d %8.2f\n", kind, guess, pairs, verified, right,
                confident_wrong, ambiguous, ms / std::max(1, pairs));
  }
};

/// Off by up to 4 m on the ground, half of the time along the direction that repeats, and by a few degrees.
Eigen::Isometry3d wrong_guess(const Eigen::Isometry3d& truth_from_to, const testing::RoomPair& pair,
                              Rng& rng) {
  const double angle = rng.uniform(-3.14, 3.14);
  Eigen::Vector3d direction(std::cos(angle), std::sin(angle), 0.0);
  if (rng.uniform() < 0.5) direction = pair.along;
  Eigen::Isometry3d off = Eigen::Isometry3d::Identity();
  off.translation() = rng.uniform(-4.0, 4.0) * direction;
  off.rotate(Eigen::AngleAxisd(0.07 * rng.normal(), Eigen::Vector3d::UnitZ()));
  // In the world's directions: T_from_to moves with the target.
  return pair.source.inverse() * off * pair.source * truth_from_to;
}

Counts compare(const std::string& kind, std::uint64_t seed, bool with_guess) {
  Rng rng(combine_seeds(seed, kind.size()));
  const testing::RoomPair pair = testing::make_room(kind, rng);
  const double noise_m = rng.uniform(0.01, 0.03);
  const std::map<Key, std::shared_ptr<const PointCloud>> scans{
      {0, pair.room.scan(pair.target, noise_m, rng)}, {1, pair.room.scan(pair.source, noise_m, rng)}};
  const Eigen::Isometry3d truth = pair.source.inverse() * pair.target;
  RegistrationTask task = pair_task(1, 0, seed);
  if (with_guess) task.guess_from_to = wrong_guess(truth, pair, rng);
  const FastRegistrar registrar(std::make_shared<FeatureCache>([&](Key key) { return scans.at(key); }));
  static_cast<void>(registrar.compute(task));  // the data of a scan are computed once
  const double start = thread_seconds();
  const RegistrationResult result = registrar.compute(task);
  Counts counts;
  counts.ms = 1e3 * (thread_seconds() - start);
  counts.pairs = 1;
  counts.ambiguous = result.reason == RejectionReason::kAmbiguous ? 1 : 0;
  if (!result.verified()) return counts;
  counts.verified = 1;
  const Eigen::Isometry3d error = result.closure->T_from_to.inverse() * truth;
  const Vector6d e = se3::log(error);
  const double chi_square = e.dot(result.closure->covariance.ldlt().solve(e));
  counts.right = error.translation().norm() < 0.3 && se3::rotation_angle(error) < 0.05 ? 1 : 0;
  counts.confident_wrong = chi_square > kChiSquare999 ? 1 : 0;
  if (chi_square > kChiSquare999) {
    std::printf("  %s %lu%s: off by %.2f m, %.1f deg, chi square %.0f\n", kind.c_str(), seed,
                with_guess ? " guess" : "", error.translation().norm(), se3::rotation_angle(error) * 57.3,
                chi_square);
  }
  return counts;
}

}  // namespace

void symmetric(const std::string& kinds, std::uint64_t count, std::uint64_t first_seed) {
  std::vector<std::pair<std::string, Counts>> rows;
  Counts all;
  for (const std::string& kind : testing::room_kinds()) {
    if (kinds != "all" && kinds != kind) continue;
    for (const bool with_guess : {false, true}) {
      Counts sum;
      for (std::uint64_t i = 0; i < count; ++i) sum.add(compare(kind, first_seed + i, with_guess));
      rows.emplace_back(kind, sum);
      all.add(sum);
    }
  }
  std::printf("%-12s %-8s %6s %9s %6s %16s %10s %8s\n", "room", "guess", "pairs", "verified", "right",
              "confident wrong", "ambiguous", "ms");
  for (std::size_t i = 0; i < rows.size(); ++i) {
    rows[i].second.print(rows[i].first.c_str(), i % 2 == 0 ? "absent" : "0-4 m");
  }
  all.print("all", "");
}

}  // namespace loopwise::bench
