// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace loopwise {

/// The descriptor of a key point: similar surroundings differ in few of its 256 bits. Aligned so that it lies
/// in one cache line.
struct alignas(32) PlaceBits {
  static constexpr std::size_t kWords = 4;
  std::array<std::uint64_t, kWords> words{};
};

/// Number of bits in which two descriptors differ.
[[nodiscard]] int differing_bits(const PlaceBits& a, const PlaceBits& b);

/// A feature in the index of a database. One cache line, so that all of it is there once its bits were
/// compared.
struct alignas(64) IndexedFeature {
  PlaceBits bits;
  float angle = 0.0F;        ///< Direction in the level frame of its place, rad.
  std::uint32_t place = 0;   ///< Number of its place.
  std::uint32_t number = 0;  ///< Among the features of its place.
};

/// Keeps those of `ids` whose descriptors differ from `query` in at most `most` bits, in their order.
void keep_similar(const PlaceBits& query, const std::vector<IndexedFeature>& all, int most,
                  std::vector<std::uint32_t>& ids);

}  // namespace loopwise
