// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/evaluation/sample_statistics.hpp>

#include "testing.hpp"

namespace loopwise::sample_statistics_test {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

TEST_CASE("sample statistics: quantiles equal those of other programs", "[evaluation][statistics]") {
  // numpy.percentile([3, 1, 4, 1, 5, 9, 2, 6], [0, 25, 50, 75, 100]) = 1, 1.75, 3.5, 5.25, 9
  const std::vector<double> values{3, 1, 4, 1, 5, 9, 2, 6};
  REQUIRE(quantile(values, 0.0) == 1.0);
  REQUIRE(quantile(values, 1.0) == 9.0);
  const Quartiles q = quartiles(values);
  REQUIRE(q.lower == 1.75);
  REQUIRE(q.median == 3.5);
  REQUIRE(q.upper == 5.25);
  REQUIRE(q.count == 8);
  REQUIRE(quartiles({kNan, 2.0, kNan, 4.0}).median == 3.0);
  REQUIRE(quartiles({kNan, 2.0}).count == 1);
  REQUIRE(std::isnan(quartiles({}).median));
  REQUIRE(quartiles({7.0}).upper == 7.0);
}

TEST_CASE("bootstrap: intervals of the median cover it with the stated probability",
          "[evaluation][statistics]") {
  // Standard normal samples of 25: the true median is 0.
  std::size_t covered = 0;
  double width = 0.0;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    Rng rng(seed);
    std::vector<double> values;
    for (int i = 0; i < 25; ++i) values.push_back(rng.normal());
    BootstrapOptions options;
    options.resamples = 1000;
    options.seed = seed;
    const Interval interval = bootstrap_median(values, options);
    REQUIRE(interval.low <= quantile(values, 0.5));
    REQUIRE(interval.high >= quantile(values, 0.5));
    covered += interval.low <= 0.0 && interval.high >= 0.0 ? 1 : 0;
    width += (interval.high - interval.low) / 400.0;
  }
  CAPTURE(covered, width);
  REQUIRE(covered >= 360);  // measured 377 of 400; half the level's tails would cover 340
  REQUIRE(covered <= 396);
  REQUIRE(width == Approx(2.0 * 1.96 * 1.2533 / 5.0).epsilon(0.15));  // by the median's asymptotic error
}

TEST_CASE("bootstrap: seeded, and degenerate samples", "[evaluation][statistics]") {
  const std::vector<double> values{1.0, 5.0, 2.0, 8.0, 4.0};
  const Interval a = bootstrap_median(values), same = bootstrap_median(values);
  REQUIRE(a.low == same.low);
  REQUIRE(a.high == same.high);
  REQUIRE(a.low >= 1.0);
  REQUIRE(a.high <= 8.0);
  REQUIRE(a.low < 4.0);
  REQUIRE(a.high > 4.0);
  REQUIRE(std::isnan(bootstrap_median(std::vector<double>{3.0, kNan}).low));
  REQUIRE(bootstrap_median(std::vector<double>{3.0, 3.0}).high == 3.0);
  REQUIRE(std::isnan(bootstrap_median(std::vector<double>()).low));
  BootstrapOptions options;
  options.level = 0.0;
  const Interval point = bootstrap_median(values, options);
  REQUIRE(point.low == point.high);
  options.resamples = 0;
  REQUIRE_THROWS_AS(bootstrap_median(values, options), OptionError);
}

TEST_CASE("bootstrap: values of a group count together", "[evaluation][statistics]") {
  // 12 missions of 8 seeds each: missions differ by 1, the seeds of one by 0.05, so that 96 values tell no
  // more of the median over missions than 12.
  std::size_t covered = 0, covered_alone = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    Rng rng(seed);
    std::vector<std::vector<double>> missions;
    std::vector<double> all;
    for (int m = 0; m < 12; ++m) {
      const double of_mission = rng.normal();
      missions.emplace_back();
      for (int s = 0; s < 8; ++s) missions.back().push_back(of_mission + 0.05 * rng.normal());
      all.insert(all.end(), missions.back().begin(), missions.back().end());
    }
    BootstrapOptions options;
    options.resamples = 400;
    options.seed = seed;
    const Interval grouped = bootstrap_median(missions, options), alone = bootstrap_median(all, options);
    covered += grouped.low <= 0.0 && grouped.high >= 0.0 ? 1 : 0;
    covered_alone += alone.low <= 0.0 && alone.high >= 0.0 ? 1 : 0;
  }
  CAPTURE(covered, covered_alone);
  REQUIRE(covered >= 180);
  REQUIRE(covered_alone <= 140);

  const std::vector<double> values{3, 1, 4, 1, 5, 9, 2, 6};
  std::vector<std::vector<double>> one_each{{kNan}};
  for (const double v : values) one_each.push_back({v, kNan});
  REQUIRE(bootstrap_median(one_each).low == bootstrap_median(values).low);
  REQUIRE(bootstrap_median(one_each).high == bootstrap_median(values).high);
  const std::vector<std::vector<double>> one{{1.0, 2.0, 3.0}, {}};
  REQUIRE(std::isnan(bootstrap_median(one).low));  // one group gives no information about others
}

TEST_CASE("paired comparison: pairs count, not the spread between them", "[evaluation][statistics]") {
  // Missions differ by a factor of 100, the methods by a tenth: only paired values show a difference.
  Rng rng(2);
  std::vector<double> a, b;
  for (int i = 0; i < 20; ++i) {
    b.push_back(std::exp(rng.uniform(-2.0, 3.0)));
    a.push_back(b.back() * (0.9 + 0.02 * rng.normal()));
  }
  const PairedComparison c = compare_paired(a, b);
  REQUIRE(c.count == 20);
  REQUIRE(c.better == 20);
  REQUIRE(c.ratio == Approx(0.9).epsilon(0.02));
  REQUIRE(c.ratio_interval.low < c.ratio);
  REQUIRE(c.ratio_interval.high > c.ratio);
  REQUIRE(c.ratio_interval.high < 0.93);
  REQUIRE(c.difference.high < 0.0);
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] - b[i];
  REQUIRE(c.mean_difference == Approx(sum / 20.0));
  // Turned round.
  const PairedComparison back = compare_paired(b, a);
  REQUIRE(back.better == 0);
  REQUIRE(back.mean_difference == -c.mean_difference);
  REQUIRE(back.difference.low == Approx(-c.difference.high));
  REQUIRE(back.ratio == Approx(1.0 / c.ratio));

  const PairedComparison gaps = compare_paired({1.0, kNan, 3.0}, {2.0, 1.0, kNan});
  REQUIRE(gaps.count == 1);
  REQUIRE(gaps.mean_difference == -1.0);
  REQUIRE(std::isnan(gaps.difference.low));
  REQUIRE(gaps.ratio == 0.5);
  REQUIRE(std::isnan(gaps.ratio_interval.high));
  REQUIRE(std::isnan(compare_paired({0.0, 1.0}, {1.0, 1.0}).ratio));
  REQUIRE(compare_paired({}, {}).count == 0);
  REQUIRE_THROWS_AS(compare_paired({1.0}, {}), InputError);
}

TEST_CASE("paired comparison: repetitions of a pair do not narrow the interval", "[evaluation][statistics]") {
  Rng rng(6);
  std::vector<double> a, b, repeated_a, repeated_b;
  std::vector<std::size_t> groups;
  for (std::size_t i = 0; i < 12; ++i) {
    b.push_back(rng.uniform(1.0, 2.0));
    a.push_back(b.back() + rng.normal(0.0, 0.2));
    for (int times = 0; times < 30; ++times) {
      repeated_a.push_back(a.back());
      repeated_b.push_back(b.back());
      groups.push_back(7 * i);  // any numbers
    }
  }
  const PairedComparison once = compare_paired(a, b), apart = compare_paired(repeated_a, repeated_b),
                         grouped = compare_paired(repeated_a, repeated_b, groups);
  REQUIRE(grouped.count == 360);
  REQUIRE(grouped.mean_difference == Approx(once.mean_difference));
  REQUIRE(grouped.difference.low == Approx(once.difference.low));
  REQUIRE(grouped.difference.high == Approx(once.difference.high));
  REQUIRE(grouped.ratio_interval.low == Approx(once.ratio_interval.low));
  REQUIRE(apart.difference.high - apart.difference.low <
          0.3 * (grouped.difference.high - grouped.difference.low));
  REQUIRE_THROWS_AS(compare_paired({1.0}, {2.0}, std::vector<std::size_t>{}), InputError);
}

}  // namespace loopwise::sample_statistics_test
