// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/study/pair_statistics.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <loopwise/core/se3.hpp>

#include "../core/constants.hpp"

namespace loopwise::study {
namespace {

double median(std::vector<double> values) {
  if (values.empty()) return kNan;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double share_of_total(std::size_t count, std::size_t total) {
  return total == 0 ? kNan : static_cast<double>(count) / static_cast<double>(total);
}

}  // namespace

PairOutcome judge(const RegistrationResult& result, const Eigen::Isometry3d& truth) {
  PairOutcome out;
  out.reason = result.reason;
  out.accepted = result.verified();
  out.error_m = out.error_rad = out.squared_mahalanobis = out.weak_sigma_m = out.weak_error = kNan;
  out.features_s = result.features_s;
  out.global_s = result.global_s;
  out.refine_s = result.refine_s;
  if (!result.T_from_to) return out;
  const Eigen::Isometry3d error = result.T_from_to->inverse() * truth;
  out.error_m = error.translation().norm();
  out.error_rad = se3::rotation_angle(error);
  if (!result.closure) return out;
  const Vector6d e = se3::log(error);
  const Matrix6d& covariance = result.closure->covariance;
  out.squared_mahalanobis = e.dot(covariance.ldlt().solve(e));
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> translation(covariance.topLeftCorner<3, 3>());
  out.weak_sigma_m = std::sqrt(translation.eigenvalues()[2]);
  out.weak_error = std::abs(translation.eigenvectors().col(2).dot(e.head<3>())) / out.weak_sigma_m;
  return out;
}

double upper_bound_95(std::size_t count, std::size_t total) {
  if (count >= total) return 1.0;
  // The share at which `count` or fewer of `total` have a chance of 5 %.
  const auto chance = [&](double p) {
    double sum = 0.0;
    for (std::size_t k = 0; k <= count; ++k) {
      const auto n = static_cast<double>(total), i = static_cast<double>(k);
      sum += std::exp(std::lgamma(n + 1) - std::lgamma(i + 1) - std::lgamma(n - i + 1) + i * std::log(p) +
                      (n - i) * std::log1p(-p));
    }
    return sum;
  };
  double low = 0.0, high = 1.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (chance(middle) > 0.05 ? low : high) = middle;
  }
  return high;
}

PairSummary summarize(const std::vector<StudyPair>& pairs, const std::vector<PairOutcome>& outcomes,
                      const std::vector<std::size_t>& chosen) {
  PairSummary out;
  std::vector<double> m, rad, features, global, refine, accepted, rejected;
  std::size_t beyond_5 = 0, beyond_95 = 0, beyond_999 = 0, degenerate_beyond = 0;
  double squared = 0.0, total = 0.0;
  for (const std::size_t i : chosen) {
    const StudyPair& pair = pairs[i];
    const PairOutcome& outcome = outcomes[i];
    ++out.pairs;
    if (pair.overlapping()) ++out.overlapping;
    features.push_back(1e3 * outcome.features_s);
    global.push_back(1e3 * outcome.global_s);
    refine.push_back(1e3 * outcome.refine_s);
    (outcome.accepted ? accepted : rejected).push_back(1e3 * outcome.seconds());
    total += 1e3 * outcome.seconds();
    if (!outcome.accepted) continue;
    ++out.accepted;
    if (outcome.weak_sigma_m >= 0.5) {
      ++out.degenerate;
      if (outcome.weak_error > 1.96) ++degenerate_beyond;
    }
    if (!outcome.right()) {
      ++out.wrong;
      if (outcome.false_accept()) ++out.false_accepts;
      continue;
    }
    if (pair.overlapping()) ++out.recalled;
    m.push_back(outcome.error_m);
    rad.push_back(outcome.error_rad);
    squared += outcome.squared_mahalanobis;
    if (outcome.squared_mahalanobis > 1.6354) ++beyond_5;
    if (outcome.squared_mahalanobis > 12.5916) ++beyond_95;
    if (outcome.squared_mahalanobis > 22.4577) ++beyond_999;
  }
  out.recall = share_of_total(out.recalled, out.overlapping);
  out.false_accept_bound = upper_bound_95(out.false_accepts, out.pairs);
  out.median_m = median(m);
  out.median_rad = median(rad);
  out.largest_m = m.empty() ? kNan : *std::max_element(m.begin(), m.end());
  out.mean_squared_error = m.empty() ? kNan : squared / static_cast<double>(m.size());
  out.beyond_5 = share_of_total(beyond_5, m.size());
  out.beyond_95 = share_of_total(beyond_95, m.size());
  out.beyond_999 = share_of_total(beyond_999, m.size());
  out.degenerate_beyond_95 = share_of_total(degenerate_beyond, out.degenerate);
  out.features_ms = median(features);
  out.global_ms = median(global);
  out.refine_ms = median(refine);
  out.accepted_ms = median(accepted);
  out.rejected_ms = median(rejected);
  out.mean_ms = out.pairs == 0 ? kNan : total / static_cast<double>(out.pairs);
  return out;
}

std::vector<Stratum> strata(const std::vector<StudyPair>& pairs, std::size_t count) {
  constexpr double kEnd = std::numeric_limits<double>::infinity();
  struct Property {
    const char* name;
    double StudyPair::*value;
    std::vector<double> edges;
  };
  const std::vector<Property> properties{
      {"distance_m", &StudyPair::distance_m, {0.0, 5.0, 10.0, 20.0, kEnd}},
      {"overlap", &StudyPair::overlap, {0.0, 0.2, 0.4, 0.6, 0.8, kEnd}},
      {"observability", &StudyPair::observability, {0.0, 0.02, 0.05, 0.1, kEnd}}};
  std::vector<Stratum> out;
  for (const Property& property : properties) {
    for (std::size_t e = 0; e + 1 < property.edges.size(); ++e) {
      Stratum stratum{property.name, property.edges[e], property.edges[e + 1], {}};
      for (std::size_t i = 0; i < std::min(count, pairs.size()); ++i) {
        const double value = pairs[i].*property.value;
        if (value >= stratum.from && value < stratum.to) stratum.pairs.push_back(i);
      }
      if (!stratum.pairs.empty()) out.push_back(std::move(stratum));
    }
  }
  return out;
}

}  // namespace loopwise::study
