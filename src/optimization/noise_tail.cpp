// SPDX-License-Identifier: BSD-3-Clause
#include "noise_tail.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace loopwise::detail {
namespace {

/// Closures are near a threshold within this factor of r², and thresholds are tried at steps of its root.
constexpr double kNear = 2.0;
/// Two counts differ clearly by this many standard deviations of their difference. They are alike within
/// kAlike standard deviations of the smaller one.
constexpr double kClear = 3.0, kAlike = 2.0;

bool clearly_fewer(double a, double b) {
  return b - a > kClear * std::sqrt(a + b);
}

}  // namespace

double end_of_tail(std::vector<double> r2, double low, double high) {
  std::sort(r2.begin(), r2.end());
  const auto count_near = [&](double threshold) {
    const auto first = std::lower_bound(r2.begin(), r2.end(), threshold / kNear);
    return static_cast<double>(std::lower_bound(first, r2.end(), threshold * kNear) - first);
  };
  const double at_low = count_near(low);
  double fewest = at_low;
  std::vector<std::pair<double, double>> tried;  // threshold, closures near it
  const int steps = static_cast<int>(std::ceil(std::log(high / low) / std::log(std::sqrt(kNear))));
  for (int k = 1; k <= steps; ++k) {
    const double threshold = k == steps ? high : std::min(high, low * std::pow(kNear, 0.5 * k));
    const double count = count_near(threshold);
    if (clearly_fewer(fewest, count)) break;
    fewest = std::min(fewest, count);
    tried.emplace_back(threshold, count);
  }
  if (!clearly_fewer(fewest, at_low)) return low;
  double end = low;
  for (const auto& [threshold, count] : tried) {
    if (count <= fewest + kAlike * std::sqrt(fewest)) end = threshold;
  }
  return end;
}

}  // namespace loopwise::detail
