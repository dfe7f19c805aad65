// SPDX-License-Identifier: BSD-3-Clause
#include "similar_bits.hpp"

namespace loopwise {
namespace {

using Differing = int (*)(const PlaceBits& a, const PlaceBits& b);
using Keep = std::size_t (*)(const PlaceBits& query, const IndexedFeature* all, int most, std::uint32_t* ids,
                             std::size_t count);

/// Counts the ones of a word by adding neighbouring bits in parallel.
int differing_portable(const PlaceBits& a, const PlaceBits& b) {
  int count = 0;
  for (std::size_t w = 0; w < PlaceBits::kWords; ++w) {
    std::uint64_t x = a.words[w] ^ b.words[w];
    x -= (x >> 1) & 0x5555555555555555ULL;
    x = (x & 0x3333333333333333ULL) + ((x >> 2) & 0x3333333333333333ULL);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fULL;
    count += static_cast<int>((x * 0x0101010101010101ULL) >> 56);
  }
  return count;
}

/// Moves the similar ones to the front. \returns how many there are
std::size_t keep_portable(const PlaceBits& query, const IndexedFeature* all, int most, std::uint32_t* ids,
                          std::size_t count) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t id = ids[i];
    ids[kept] = id;
    kept += differing_portable(query, all[id].bits) <= most ? 1 : 0;
  }
  return kept;
}

#if defined(__x86_64__) && defined(__GNUC__)
/// The same with the instruction popcnt, which the oldest x86-64 processors do not have.
__attribute__((target("popcnt"))) int differing_popcnt(const PlaceBits& a, const PlaceBits& b) {
  int count = 0;
  for (std::size_t w = 0; w < PlaceBits::kWords; ++w) count += __builtin_popcountll(a.words[w] ^ b.words[w]);
  return count;
}

__attribute__((target("popcnt"))) std::size_t keep_popcnt(const PlaceBits& query, const IndexedFeature* all,
                                                          int most, std::uint32_t* ids, std::size_t count) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t id = ids[i];
    ids[kept] = id;  // no branch, which would be predicted badly
    kept += differing_popcnt(query, all[id].bits) <= most ? 1 : 0;
  }
  return kept;
}

const bool has_popcnt = __builtin_cpu_supports("popcnt") != 0;
const Differing differing = has_popcnt ? differing_popcnt : differing_portable;
const Keep keep = has_popcnt ? keep_popcnt : keep_portable;
#else
const Differing differing = differing_portable;
const Keep keep = keep_portable;
#endif

}  // namespace

int differing_bits(const PlaceBits& a, const PlaceBits& b) {
  return differing(a, b);
}

void keep_similar(const PlaceBits& query, const std::vector<IndexedFeature>& all, int most,
                  std::vector<std::uint32_t>& ids) {
  ids.resize(keep(query, all.data(), most, ids.data(), ids.size()));
}

}  // namespace loopwise
