// SPDX-License-Identifier: BSD-3-Clause
#include "consensus.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <string>

#include <Eigen/SVD>

#include <loopwise/core/bit_matrix.hpp>
#include <loopwise/core/error.hpp>

#include "sort_falling.hpp"

namespace loopwise {
namespace {

using CommonOnes = std::uint32_t (*)(const std::uint64_t* a, const std::uint64_t* b, std::size_t words);

/// Number of ones that two rows share. Counts the ones of a word by adding neighbouring bits in parallel.
std::uint32_t common_ones_portable(const std::uint64_t* a, const std::uint64_t* b, std::size_t words) {
  std::uint32_t count = 0;
  for (std::size_t w = 0; w < words; ++w) {
    std::uint64_t x = a[w] & b[w];
    x -= (x >> 1) & 0x5555555555555555ULL;
    x = (x & 0x3333333333333333ULL) + ((x >> 2) & 0x3333333333333333ULL);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fULL;
    count += static_cast<std::uint32_t>((x * 0x0101010101010101ULL) >> 56);
  }
  return count;
}

#if defined(__x86_64__) && defined(__GNUC__)
/// The same with the instruction popcnt, which the oldest x86-64 processors do not have.
__attribute__((target("popcnt"))) std::uint32_t common_ones_popcnt(const std::uint64_t* a,
                                                                   const std::uint64_t* b,
                                                                   std::size_t words) {
  std::uint64_t count = 0;
  for (std::size_t w = 0; w < words; ++w) {
    count += static_cast<std::uint64_t>(__builtin_popcountll(a[w] & b[w]));
  }
  return static_cast<std::uint32_t>(count);
}
const CommonOnes common_ones = __builtin_cpu_supports("popcnt") ? common_ones_popcnt : common_ones_portable;
#else
const CommonOnes common_ones = common_ones_portable;
#endif

std::uint32_t common(const BitMatrix& bits, std::size_t i, std::size_t j) {
  return common_ones(bits.row(i), bits.row(j), bits.words());
}

/// Two matches are compatible if the cosines of the angle between their normals differ by at most this: 25
/// degrees near a right angle.
constexpr float kNormalTolerance = 0.45F;

/// Matches by coordinate, so that they are compared with SIMD: source, target, source normal, target normal.
using Columns = Eigen::Array<float, Eigen::Dynamic, 12>;

bool has_normals(const Match& match) {
  return !match.source_normal.isZero(0.0F) && !match.target_normal.isZero(0.0F);
}

std::vector<std::size_t> inliers_of(const std::vector<Match>& matches, const Columns& m,
                                    const Eigen::Isometry3d& T, double tolerance_m,
                                    Eigen::ArrayXf& sq_distances) {
  const Eigen::Matrix3f R = T.linear().cast<float>();
  const Eigen::Vector3f t = T.translation().cast<float>();
  const auto sq_tolerance = static_cast<float>(tolerance_m * tolerance_m);
  sq_distances = (R(0, 0) * m.col(0) + R(0, 1) * m.col(1) + R(0, 2) * m.col(2) + t[0] - m.col(3)).square() +
                 (R(1, 0) * m.col(0) + R(1, 1) * m.col(1) + R(1, 2) * m.col(2) + t[1] - m.col(4)).square() +
                 (R(2, 0) * m.col(0) + R(2, 1) * m.col(1) + R(2, 2) * m.col(2) + t[2] - m.col(5)).square();
  std::vector<std::size_t> inliers;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (sq_distances[static_cast<Eigen::Index>(i)] > sq_tolerance) continue;
    const Match& match = matches[i];
    if ((R * match.source_normal).dot(match.target_normal) < 0.7F && has_normals(match)) continue;
    inliers.push_back(i);
  }
  return inliers;
}

bool similar(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, double tolerance_m) {
  const double cosine = 0.5 * ((a.linear().transpose() * b.linear()).trace() - 1.0);
  return (a.translation() - b.translation()).norm() < tolerance_m && cosine > 0.9986;  // 3 degrees
}

Columns columns_of(const std::vector<Match>& matches) {
  Columns m(static_cast<Eigen::Index>(matches.size()), 12);
  for (std::size_t i = 0; i < matches.size(); ++i) {
    m.row(static_cast<Eigen::Index>(i)) << matches[i].source.transpose(), matches[i].target.transpose(),
        matches[i].source_normal.transpose(), matches[i].target_normal.transpose();
    // One normal alone says nothing. With both zero, the angles to the normals of other matches are equal.
    if (!has_normals(matches[i])) m.row(static_cast<Eigen::Index>(i)).tail<6>().setZero();
  }
  return m;
}

/// Which matches are compatible with each other, see consensus().
BitMatrix compatibility(const Columns& m, float tolerance_m) {
  BitMatrix compatible(static_cast<std::size_t>(m.rows()));
  Eigen::ArrayXf source_m(m.rows()), target_m(m.rows()), turn(m.rows());
  for (Eigen::Index i = 0; i + 1 < m.rows(); ++i) {
    const Eigen::Index rest = m.rows() - i - 1;
    const auto others = [&](Eigen::Index column) { return m.col(column).tail(rest); };
    source_m.tail(rest) =
        (others(0) - m(i, 0)).square() + (others(1) - m(i, 1)).square() + (others(2) - m(i, 2)).square();
    target_m.tail(rest) =
        (others(3) - m(i, 3)).square() + (others(4) - m(i, 4)).square() + (others(5) - m(i, 5)).square();
    turn.tail(rest) = others(6) * m(i, 6) + others(7) * m(i, 7) + others(8) * m(i, 8) - others(9) * m(i, 9) -
                      others(10) * m(i, 10) - others(11) * m(i, 11);
    source_m.tail(rest) = source_m.tail(rest).sqrt();
    target_m.tail(rest) = target_m.tail(rest).sqrt();
    for (Eigen::Index j = i + 1; j < m.rows(); ++j) {
      const float a = source_m[j], b = target_m[j];
      if (std::abs(a - b) > tolerance_m || std::max(a, b) < 2.0F * tolerance_m) continue;
      if (std::abs(turn[j]) > kNormalTolerance) continue;
      compatible.set(static_cast<std::size_t>(i), static_cast<std::size_t>(j));
      compatible.set(static_cast<std::size_t>(j), static_cast<std::size_t>(i));
    }
  }
  return compatible;
}

/// Twice the number of triangles at each match: the sum over its compatible matches of those that are
/// compatible with both.
std::vector<std::uint64_t> count_triangles(const BitMatrix& compatible, std::size_t n) {
  std::vector<std::uint64_t> triangles(n, 0);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = i + 1; j < n; ++j) {
      if (!compatible.get(i, j)) continue;
      const std::uint32_t shared = common(compatible, i, j);
      triangles[i] += shared;
      triangles[j] += shared;
    }
  }
  return triangles;
}

/// A clique that is built greedily from the seed's best partners.
std::vector<std::size_t> clique_of(const BitMatrix& compatible, std::size_t n, std::size_t seed) {
  constexpr std::size_t kLargest = 20;
  std::vector<std::pair<std::uint32_t, std::size_t>> partners;
  for (std::size_t j = 0; j < n; ++j) {
    if (compatible.get(seed, j)) partners.emplace_back(common(compatible, seed, j), j);
  }
  std::sort(partners.begin(), partners.end(), [](const auto& a, const auto& b) {
    return a.first != b.first ? a.first > b.first : a.second < b.second;
  });
  std::vector<std::size_t> clique{seed};
  for (const auto& [shared, j] : partners) {
    if (shared == 0 || clique.size() == kLargest) break;
    if (std::all_of(clique.begin(), clique.end(),
                    [&, k = j](std::size_t i) { return compatible.get(i, k); })) {
      clique.push_back(j);
    }
  }
  return clique;
}

}  // namespace

Eigen::Isometry3d fit_rigid(const std::vector<Match>& matches, const std::vector<std::size_t>& chosen) {
  Eigen::Vector3d source = Eigen::Vector3d::Zero(), target = Eigen::Vector3d::Zero();
  for (const std::size_t i : chosen) {
    source += matches[i].source.cast<double>();
    target += matches[i].target.cast<double>();
  }
  const auto n = static_cast<double>(std::max<std::size_t>(1, chosen.size()));
  source /= n;
  target /= n;
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  for (const std::size_t i : chosen) {
    moment +=
        (matches[i].target.cast<double>() - target) * (matches[i].source.cast<double>() - source).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(moment, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d signs = Eigen::Vector3d::Ones();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0) signs.z() = -1.0;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  T.translation() = target - T.linear() * source;
  return T;
}

Consensus find_consensus(const std::vector<Match>& matches, double tolerance_m, std::size_t count,
                         const PoseFilter& allowed) {
  const std::size_t n = matches.size();
  Consensus consensus;
  std::vector<Hypothesis>& hypotheses = consensus.hypotheses;
  if (n < 3 || count == 0) return consensus;
  const Columns m = columns_of(matches);
  const BitMatrix compatible = compatibility(m, static_cast<float>(tolerance_m));
  const std::vector<std::uint64_t> triangles = count_triangles(compatible, n);
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return triangles[a] != triangles[b] ? triangles[a] > triangles[b] : a < b;
  });

  std::vector<char> covered(n, 0);
  Eigen::ArrayXf sq_distances;
  const std::size_t max_seeds = 5 * count;
  std::size_t seeds = 0;
  for (const std::size_t seed : order) {
    if (seeds == max_seeds || triangles[seed] == 0) break;
    if (covered[seed]) continue;
    ++seeds;
    const std::vector<std::size_t> clique = clique_of(compatible, n, seed);
    if (clique.size() < 3) continue;
    Eigen::Isometry3d T = fit_rigid(matches, clique);
    std::vector<std::size_t> inliers = inliers_of(matches, m, T, 1.5 * tolerance_m, sq_distances);
    for (int pass = 0; pass < 2 && inliers.size() >= 3; ++pass) {
      T = fit_rigid(matches, inliers);
      inliers = inliers_of(matches, m, T, tolerance_m, sq_distances);
    }
    for (const std::size_t i : inliers) covered[i] = 1;
    if (inliers.size() < 3 || !T.matrix().allFinite()) continue;
    if (std::any_of(hypotheses.begin(), hypotheses.end(),
                    [&](const Hypothesis& h) { return similar(h.T_target_source, T, tolerance_m); })) {
      continue;
    }
    if (allowed && !allowed(T)) {
      ++consensus.refused;
      continue;
    }
    hypotheses.push_back({T, inliers.size()});
  }
  sort_falling(hypotheses, [](const Hypothesis& h) { return h.inliers; });
  if (hypotheses.size() > count) hypotheses.resize(count);
  return consensus;
}

Consensus consensus(const std::vector<Match>& matches, const ConsensusOptions& options,
                    const PoseFilter& allowed) {
  validate(options);
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const Match& match = matches[i];
    if (match.source.allFinite() && match.target.allFinite() && match.source_normal.allFinite() &&
        match.target_normal.allFinite()) {
      continue;
    }
    throw InputError("consensus: match " + std::to_string(i) + " is not finite: leave it out");
  }
  return find_consensus(matches, options.tolerance_m, static_cast<std::size_t>(options.max_hypotheses),
                        allowed);
}

}  // namespace loopwise
