// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Statistics of few repetitions: medians, their spread, and paired comparison of methods.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>

namespace loopwise {

/// Quantile `p` of the values, by linear interpolation between order statistics (Hyndman and Fan 1996,
/// definition 7). NaN without values. \pre all finite, p in [0, 1]
[[nodiscard]] LOOPWISE_EXPORT double quantile(std::vector<double> values, double p);

/// The middle half of a sample; NaN if it is empty.
struct Quartiles {
  std::size_t count = 0;                                     ///< Values, NaN left out.
  double lower = std::numeric_limits<double>::quiet_NaN();   ///< A quarter lies below.
  double median = std::numeric_limits<double>::quiet_NaN();  ///< Half lies below.
  double upper = std::numeric_limits<double>::quiet_NaN();   ///< Three quarters lie below.
};
/// Values that are NaN do not count.
[[nodiscard]] LOOPWISE_EXPORT Quartiles quartiles(const std::vector<double>& values);

/// How intervals are drawn.
struct BootstrapOptions {
  /// Number of samples drawn with replacement.
  std::int64_t resamples = 10000;
  /// Confidence level of the intervals.
  double level = 0.95;
  /// Seed of the random draws.
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("resamples", self.resamples, at_least(1));
    field("level", self.level, between(0.0, 1.0));
    field("seed", self.seed, at_least(0));
  }
};

/// NaN for fewer than two values.
struct Interval {
  double low = std::numeric_limits<double>::quiet_NaN();   ///< Lower end.
  double high = std::numeric_limits<double>::quiet_NaN();  ///< Upper end.
};

/// Percentile bootstrap interval (Efron 1979) of the median. Values that are NaN do not count. With few
/// values it is not wider than their range: for five values, it ends at the smallest and largest at most.
/// \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT Interval bootstrap_median(const std::vector<double>& values,
                                                        const BootstrapOptions& options = {});

/// The same for values in groups, such as the seeds of one mission: values of a group are not independent, so
/// each resample draws whole groups. The median is that of all values.
[[nodiscard]] LOOPWISE_EXPORT Interval bootstrap_median(const std::vector<std::vector<double>>& groups,
                                                        const BootstrapOptions& options = {});

/// One method against another on the same missions.
struct PairedComparison {
  std::size_t count = 0;                                              ///< Pairs without NaN.
  std::size_t better = 0;                                             ///< Pairs with a < b.
  double mean_difference = std::numeric_limits<double>::quiet_NaN();  ///< Of a − b.
  Interval difference;                                                ///< Of the mean difference.
  /// Geometric mean of a / b: missions have equal weight for any size of their errors. NaN if any is not > 0.
  double ratio = std::numeric_limits<double>::quiet_NaN();
  Interval ratio_interval;  ///< Of that ratio.
};

/// Percentile bootstrap over the pairs: each resample draws pairs, not values.
/// \throws InputError unless both have one length; OptionError
[[nodiscard]] LOOPWISE_EXPORT PairedComparison compare_paired(const std::vector<double>& a,
                                                              const std::vector<double>& b,
                                                              const BootstrapOptions& options = {});

/// The same for pairs in groups: each resample draws whole groups, so that dependent pairs do not narrow the
/// intervals. `groups` has the number of each pair's group.
[[nodiscard]] LOOPWISE_EXPORT PairedComparison compare_paired(const std::vector<double>& a,
                                                              const std::vector<double>& b,
                                                              const std::vector<std::size_t>& groups,
                                                              const BootstrapOptions& options = {});

}  // namespace loopwise
