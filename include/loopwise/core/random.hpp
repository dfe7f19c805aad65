// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Random numbers that are equal on all systems. The standard library defines its engines exactly, but not
/// its distributions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>

namespace loopwise {

/// One step of SplitMix64 (Steele, Lea, Flood 2014): a good 64-bit hash of `x`.
[[nodiscard]] constexpr std::uint64_t mix64(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

/// A seed that depends on both arguments and on their order.
[[nodiscard]] constexpr std::uint64_t combine_seeds(std::uint64_t a, std::uint64_t b) {
  return mix64(mix64(a) ^ (b + 0x632be59bd9b4e019ULL));
}

/// Seed for the computation of a pair. It is a function of (seed, from, to) and does not depend on the order
/// of the work.
[[nodiscard]] constexpr std::uint64_t pair_seed(std::uint64_t seed, Key from, Key to) {
  return combine_seeds(combine_seeds(seed, from), to);
}

/// xoshiro256** (Blackman, Vigna 2018), seeded through SplitMix64, with its own distributions. Satisfies
/// UniformRandomBitGenerator. Cheap to copy. Do not share one between threads.
class LOOPWISE_EXPORT Rng {
 public:
  using result_type = std::uint64_t;  ///< 64 random bits.

  /// Equal seeds give equal sequences on every machine.
  explicit Rng(std::uint64_t seed);

  /// Smallest number that operator() returns.
  static constexpr result_type min() { return 0; }
  /// Largest number that operator() returns.
  static constexpr result_type max() { return ~result_type{0}; }
  /// The next 64 random bits.
  result_type operator()();

  /// In [0, 1), 53 random bits.
  double uniform();
  /// In [low, high).
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  /// In [0, count), unbiased. \pre count > 0
  std::uint64_t below(std::uint64_t count);
  /// Standard normal by the polar method.
  double normal();
  /// Normal with this mean and standard deviation.
  double normal(double mean, double sigma) { return mean + sigma * normal(); }

  /// Shuffles uniformly (Fisher and Yates).
  template <class Container>
  void shuffle(Container& items) {
    for (std::size_t i = items.size(); i > 1; --i) {
      std::swap(items[i - 1], items[static_cast<std::size_t>(below(i))]);
    }
  }

 private:
  std::uint64_t state_[4];
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace loopwise
