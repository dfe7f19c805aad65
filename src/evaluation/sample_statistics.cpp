// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/sample_statistics.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <string>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

namespace loopwise {
namespace {

std::vector<double> known(const std::vector<double>& values) {
  std::vector<double> out;
  std::copy_if(values.begin(), values.end(), std::back_inserter(out),
               [](double v) { return !std::isnan(v); });
  return out;
}

double sorted_quantile(const std::vector<double>& sorted, double p) {
  if (sorted.empty()) return std::numeric_limits<double>::quiet_NaN();
  const double place = p * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (place - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return sorted_quantile(values, 0.5);
}

double mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

/// Interval of `statistic` over resamples of `groups`, each drawn with all its values.
template <class Statistic>
Interval bootstrap(const std::vector<std::vector<double>>& groups, const BootstrapOptions& options,
                   Statistic&& statistic) {
  validate(options);
  if (groups.size() < 2) return {};
  Rng rng(options.seed);
  std::vector<double> of_resamples, resample;
  for (std::int64_t i = 0; i < options.resamples; ++i) {
    resample.clear();
    for (std::size_t draw = 0; draw < groups.size(); ++draw) {
      const std::vector<double>& group = groups[static_cast<std::size_t>(rng.below(groups.size()))];
      resample.insert(resample.end(), group.begin(), group.end());
    }
    of_resamples.push_back(statistic(resample));
  }
  std::sort(of_resamples.begin(), of_resamples.end());
  const double tail = 0.5 * (1.0 - options.level);
  return {sorted_quantile(of_resamples, tail), sorted_quantile(of_resamples, 1.0 - tail)};
}

/// One group for each value.
std::vector<std::vector<double>> singles(const std::vector<double>& values) {
  std::vector<std::vector<double>> groups;
  groups.reserve(values.size());
  for (const double v : values) groups.push_back({v});
  return groups;
}

std::vector<std::vector<double>> values_of(const std::map<std::size_t, std::vector<double>>& groups) {
  std::vector<std::vector<double>> values;
  values.reserve(groups.size());
  for (const auto& [group, own] : groups) values.push_back(own);
  return values;
}

}  // namespace

double quantile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return sorted_quantile(values, p);
}

Quartiles quartiles(const std::vector<double>& values) {
  std::vector<double> sorted = known(values);
  std::sort(sorted.begin(), sorted.end());
  return {sorted.size(), sorted_quantile(sorted, 0.25), sorted_quantile(sorted, 0.5),
          sorted_quantile(sorted, 0.75)};
}

Interval bootstrap_median(const std::vector<double>& values, const BootstrapOptions& options) {
  return bootstrap(singles(known(values)), options, median);
}

Interval bootstrap_median(const std::vector<std::vector<double>>& groups, const BootstrapOptions& options) {
  std::vector<std::vector<double>> of_known;
  for (const std::vector<double>& group : groups) {
    if (auto values = known(group); !values.empty()) of_known.push_back(std::move(values));
  }
  return bootstrap(of_known, options, median);
}

PairedComparison compare_paired(const std::vector<double>& a, const std::vector<double>& b,
                                const BootstrapOptions& options) {
  std::vector<std::size_t> each(a.size());
  std::iota(each.begin(), each.end(), std::size_t{0});
  return compare_paired(a, b, each, options);
}

PairedComparison compare_paired(const std::vector<double>& a, const std::vector<double>& b,
                                const std::vector<std::size_t>& groups, const BootstrapOptions& options) {
  if (a.size() != b.size() || a.size() != groups.size()) {
    throw InputError("paired comparison: " + std::to_string(a.size()) + " values against " +
                     std::to_string(b.size()) + " in " + std::to_string(groups.size()) + " groups");
  }
  validate(options);
  PairedComparison out;
  std::vector<double> differences, logs;
  std::map<std::size_t, std::vector<double>> differences_of, logs_of;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (std::isnan(a[i]) || std::isnan(b[i])) continue;
    ++out.count;
    out.better += a[i] < b[i] ? 1 : 0;
    differences.push_back(a[i] - b[i]);
    differences_of[groups[i]].push_back(differences.back());
    if (!(a[i] > 0.0 && b[i] > 0.0)) continue;
    logs.push_back(std::log(a[i] / b[i]));
    logs_of[groups[i]].push_back(logs.back());
  }
  if (out.count == 0) return out;
  out.mean_difference = mean(differences);
  out.difference = bootstrap(values_of(differences_of), options, mean);
  if (logs.size() < out.count) return out;
  out.ratio = std::exp(mean(logs));
  const Interval of_logs = bootstrap(values_of(logs_of), options, mean);
  out.ratio_interval = {std::exp(of_logs.low), std::exp(of_logs.high)};
  return out;
}

}  // namespace loopwise
