// SPDX-License-Identifier: BSD-3-Clause
#include "matching.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#ifdef __SSE2__
#include <emmintrin.h>
#endif

namespace loopwise {
namespace {

constexpr std::size_t kBlock = PackedDescriptors::kBlock, kPairs = PackedDescriptors::kPairs;
constexpr std::size_t kSources = 4;  // sources compared at a time, for which a target block is loaded once

using Similarities = std::array<std::array<std::int32_t, kBlock>, kSources>;

/// Scalar products of the descriptors of `block` with four others; `others` holds each one's pair of
/// components as one 32-bit number, [pair][which].
#ifdef __SSE2__
void compare(const std::int16_t* block, const std::int32_t* others, Similarities& out) {
  __m128i low[kSources], high[kSources];
  for (std::size_t s = 0; s < kSources; ++s) low[s] = high[s] = _mm_setzero_si128();
  for (std::size_t pair = 0; pair < kPairs; ++pair) {
    const __m128i a = _mm_loadu_si128(reinterpret_cast<const __m128i*>(block + pair * 2 * kBlock));
    const __m128i b = _mm_loadu_si128(reinterpret_cast<const __m128i*>(block + pair * 2 * kBlock + kBlock));
    for (std::size_t s = 0; s < kSources; ++s) {
      const __m128i other = _mm_set1_epi32(others[pair * kSources + s]);
      low[s] = _mm_add_epi32(low[s], _mm_madd_epi16(a, other));
      high[s] = _mm_add_epi32(high[s], _mm_madd_epi16(b, other));
    }
  }
  for (std::size_t s = 0; s < kSources; ++s) {
    _mm_storeu_si128(reinterpret_cast<__m128i*>(out[s].data()), low[s]);
    _mm_storeu_si128(reinterpret_cast<__m128i*>(out[s].data() + kBlock / 2), high[s]);
  }
}
#else
void compare(const std::int16_t* block, const std::int32_t* others, Similarities& out) {
  out = {};
  for (std::size_t pair = 0; pair < kPairs; ++pair) {
    for (std::size_t s = 0; s < kSources; ++s) {
      const std::int32_t both = others[pair * kSources + s];
      const std::int32_t first = static_cast<std::int16_t>(both & 0xffff), second = both >> 16;
      for (std::size_t t = 0; t < kBlock; ++t) {
        const std::int16_t* a = block + (pair * kBlock + t) * 2;
        out[s][t] += first * a[0] + second * a[1];
      }
    }
  }
}
#endif

}  // namespace

PackedDescriptors::PackedDescriptors(const Descriptors& descriptors)
    : size_(static_cast<std::size_t>(descriptors.cols())), packed_(blocks() * kPairs * 2 * kBlock, 0) {
  constexpr float kOne = 16384.0F;
  for (std::size_t i = 0; i < size_; ++i) {
    std::int16_t* begin = packed_.data() + (i / kBlock) * kPairs * 2 * kBlock + 2 * (i % kBlock);
    for (std::size_t k = 0; k < static_cast<std::size_t>(kFpfhSize); ++k) {
      const float value = descriptors(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(i));
      begin[(k / 2) * 2 * kBlock + k % 2] = static_cast<std::int16_t>(std::lround(value * kOne));
    }
  }
}

std::vector<DescriptorMatch> match_descriptors(const PackedDescriptors& source,
                                               const PackedDescriptors& target) {
  std::vector<DescriptorMatch> matches;
  if (source.size() == 0 || target.size() == 0) return matches;
  matches.resize(source.size());
  const std::size_t targets = target.blocks() * kBlock;
  std::vector<std::int32_t> best_of_target(targets, -1);
  std::vector<std::int32_t> best_source(targets, 0);
  std::array<std::int32_t, kPairs * kSources> others;
  Similarities similarity;
  for (std::size_t begin = 0; begin < source.size(); begin += kSources) {
    const std::size_t width = std::min(kSources, source.size() - begin);
    // Four descriptors of a block of eight. Their pairs of components are adjacent in memory.
    const std::int16_t* from = source.block(begin / kBlock) + 2 * (begin % kBlock);
    for (std::size_t pair = 0; pair < kPairs; ++pair) {
      for (std::size_t s = 0; s < kSources; ++s) {
        const std::int16_t* both = from + pair * 2 * kBlock + 2 * s;
        others[pair * kSources + s] = static_cast<std::int32_t>(
            static_cast<std::uint32_t>(static_cast<std::uint16_t>(both[0])) |
            (static_cast<std::uint32_t>(static_cast<std::uint16_t>(both[1])) << 16));
      }
    }
    std::array<std::array<std::int32_t, kBlock>, kSources> best, best_block{};
    for (auto& lanes : best) lanes.fill(-1);
    for (std::size_t b = 0; b < target.blocks(); ++b) {
      compare(target.block(b), others.data(), similarity);
      std::int32_t* of_target = best_of_target.data() + b * kBlock;
      std::int32_t* by_source = best_source.data() + b * kBlock;
      const auto here = static_cast<std::int32_t>(b);
      for (std::size_t s = 0; s < width; ++s) {
        const auto number = static_cast<std::int32_t>(begin + s);
        for (std::size_t t = 0; t < kBlock; ++t) {
          const std::int32_t value = similarity[s][t];
          const bool nearer = value > best[s][t];
          best[s][t] = nearer ? value : best[s][t];
          best_block[s][t] = nearer ? here : best_block[s][t];
          const bool better = value > of_target[t];
          of_target[t] = better ? value : of_target[t];
          by_source[t] = better ? number : by_source[t];
        }
      }
    }
    for (std::size_t s = 0; s < width; ++s) {
      DescriptorMatch& match = matches[begin + s];
      match.source = static_cast<std::uint32_t>(begin + s);
      match.similarity = -1;
      for (std::size_t t = 0; t < kBlock; ++t) {
        const auto index = static_cast<std::uint32_t>(best_block[s][t]) * static_cast<std::uint32_t>(kBlock) +
                           static_cast<std::uint32_t>(t);
        if (index >= target.size()) continue;
        if (best[s][t] > match.similarity || (best[s][t] == match.similarity && index < match.target)) {
          match.similarity = best[s][t];
          match.target = index;
        }
      }
    }
  }
  for (DescriptorMatch& match : matches) {
    match.mutual = best_source[match.target] == static_cast<std::int32_t>(match.source);
  }
  return matches;
}

}  // namespace loopwise
