// SPDX-License-Identifier: BSD-3-Clause
#include "matching.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>

#include <loopwise/core/error.hpp>

#include "surface.hpp"

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace loopwise {
namespace {

constexpr std::size_t kBlock = PackedDescriptors::kBlock, kPairs = PackedDescriptors::kPairs;
constexpr std::size_t kSources = 4;  // sources compared at a time, for which a target block is loaded once

using Lanes = std::array<std::int32_t, kBlock>;

/// The most similar target of each of four sources, by lane of the target's blocks.
struct BestTargets {
  std::array<Lanes, kSources> similarity, block;
};

/// The most similar source of each target, in the order of the blocks.
struct BestSources {
  std::vector<std::int32_t> similarity, source;
};

/// Compares all targets with up to four sources. `others` holds the sources' pairs of components as one
/// 32-bit number each, [pair][which]; `begin` is the number of the first source, `width` how many there are.
using Compare = void (*)(const PackedDescriptors& target, const std::int32_t* others, std::size_t begin,
                         std::size_t width, BestTargets& best, BestSources& of_targets);

/// Scalar products of the descriptors of `block` with four others.
#ifdef __SSE2__
void multiply(const std::int16_t* block, const std::int32_t* others, std::array<Lanes, kSources>& out) {
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
void multiply(const std::int16_t* block, const std::int32_t* others, std::array<Lanes, kSources>& out) {
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

void compare_portable(const PackedDescriptors& target, const std::int32_t* others, std::size_t begin,
                      std::size_t width, BestTargets& best, BestSources& of_targets) {
  std::array<Lanes, kSources> similarity;
  for (std::size_t b = 0; b < target.blocks(); ++b) {
    multiply(target.block(b), others, similarity);
    std::int32_t* of_target = of_targets.similarity.data() + b * kBlock;
    std::int32_t* by_source = of_targets.source.data() + b * kBlock;
    const auto here = static_cast<std::int32_t>(b);
    for (std::size_t s = 0; s < width; ++s) {
      const auto number = static_cast<std::int32_t>(begin + s);
      for (std::size_t t = 0; t < kBlock; ++t) {
        const std::int32_t value = similarity[s][t];
        const bool nearer = value > best.similarity[s][t];
        best.similarity[s][t] = nearer ? value : best.similarity[s][t];
        best.block[s][t] = nearer ? here : best.block[s][t];
        const bool better = value > of_target[t];
        of_target[t] = better ? value : of_target[t];
        by_source[t] = better ? number : by_source[t];
      }
    }
  }
}

#if defined(__x86_64__) && defined(__GNUC__)
__attribute__((target("avx2"))) inline __m256i load(const std::int32_t* from) {
  return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(from));
}

__attribute__((target("avx2"))) inline void store(__m256i from, std::int32_t* to) {
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(to), from);
}

/// The same with 256-bit registers, which hold a block.
__attribute__((target("avx2"))) void compare_avx2(const PackedDescriptors& target, const std::int32_t* others,
                                                  std::size_t begin, std::size_t width, BestTargets& best,
                                                  BestSources& of_targets) {
  static_assert(kBlock == 8, "a register holds a block");
  __m256i most[kSources], where[kSources];
  for (std::size_t s = 0; s < kSources; ++s) {
    most[s] = load(best.similarity[s].data());
    where[s] = load(best.block[s].data());
  }
  for (std::size_t b = 0; b < target.blocks(); ++b) {
    const std::int16_t* block = target.block(b);
    __m256i similarity[kSources];
    for (__m256i& lanes : similarity) lanes = _mm256_setzero_si256();
    for (std::size_t pair = 0; pair < kPairs; ++pair) {
      const __m256i a = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(block + pair * 2 * kBlock));
      for (std::size_t s = 0; s < kSources; ++s) {
        const __m256i other = _mm256_set1_epi32(others[pair * kSources + s]);
        similarity[s] = _mm256_add_epi32(similarity[s], _mm256_madd_epi16(a, other));
      }
    }
    __m256i of_target = load(of_targets.similarity.data() + b * kBlock);
    __m256i by_source = load(of_targets.source.data() + b * kBlock);
    const __m256i here = _mm256_set1_epi32(static_cast<std::int32_t>(b));
    for (std::size_t s = 0; s < width; ++s) {
      const __m256i value = similarity[s];
      const __m256i nearer = _mm256_cmpgt_epi32(value, most[s]);
      most[s] = _mm256_blendv_epi8(most[s], value, nearer);
      where[s] = _mm256_blendv_epi8(where[s], here, nearer);
      const __m256i better = _mm256_cmpgt_epi32(value, of_target);
      const __m256i number = _mm256_set1_epi32(static_cast<std::int32_t>(begin + s));
      of_target = _mm256_blendv_epi8(of_target, value, better);
      by_source = _mm256_blendv_epi8(by_source, number, better);
    }
    store(of_target, of_targets.similarity.data() + b * kBlock);
    store(by_source, of_targets.source.data() + b * kBlock);
  }
  for (std::size_t s = 0; s < kSources; ++s) {
    store(most[s], best.similarity[s].data());
    store(where[s], best.block[s].data());
  }
}
const Compare compare_fast = __builtin_cpu_supports("avx2") ? compare_avx2 : compare_portable;
#else
const Compare compare_fast = compare_portable;
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

std::vector<DescriptorMatch> most_similar(const PackedDescriptors& target, const PackedDescriptors& source,
                                          bool portable) {
  const Compare compare = portable ? compare_portable : compare_fast;
  std::vector<DescriptorMatch> matches;
  if (source.size() == 0 || target.size() == 0) return matches;
  matches.resize(source.size());
  const std::size_t targets = target.blocks() * kBlock;
  BestSources of_targets{std::vector<std::int32_t>(targets, -1), std::vector<std::int32_t>(targets, 0)};
  std::array<std::int32_t, kPairs * kSources> others;
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
    BestTargets best{};
    for (Lanes& lanes : best.similarity) lanes.fill(-1);
    compare(target, others.data(), begin, width, best, of_targets);
    for (std::size_t s = 0; s < width; ++s) {
      DescriptorMatch& match = matches[begin + s];
      match.source = static_cast<std::uint32_t>(begin + s);
      match.similarity = -1;
      for (std::size_t t = 0; t < kBlock; ++t) {
        const auto index = static_cast<std::uint32_t>(best.block[s][t]) * static_cast<std::uint32_t>(kBlock) +
                           static_cast<std::uint32_t>(t);
        if (index >= target.size()) continue;
        if (best.similarity[s][t] > match.similarity ||
            (best.similarity[s][t] == match.similarity && index < match.target)) {
          match.similarity = best.similarity[s][t];
          match.target = index;
        }
      }
    }
  }
  for (DescriptorMatch& match : matches) {
    match.mutual = of_targets.source[match.target] == static_cast<std::int32_t>(match.source);
  }
  return matches;
}

std::vector<DescriptorMatch> best_matches(std::vector<DescriptorMatch> matches, std::size_t max_matches) {
  std::stable_sort(matches.begin(), matches.end(), [](const DescriptorMatch& a, const DescriptorMatch& b) {
    return a.mutual != b.mutual ? a.mutual : a.similarity > b.similarity;
  });
  if (matches.size() > max_matches) matches.resize(max_matches);
  return matches;
}

std::vector<DescriptorMatch> match_descriptors(const Descriptors& target, const Descriptors& source,
                                               std::size_t max_matches) {
  std::vector<DescriptorMatch> matches = most_similar(PackedDescriptors(target), PackedDescriptors(source));
  // A zero column has the similarity 0 to all others.
  matches.erase(std::remove_if(matches.begin(), matches.end(),
                               [](const DescriptorMatch& match) { return match.similarity <= 0; }),
                matches.end());
  return best_matches(std::move(matches), max_matches);
}

std::vector<Match> matched_points(const PointNormalView& target, const PointNormalView& source,
                                  const std::vector<DescriptorMatch>& matches) {
  const SurfaceReader to(target), from(source);
  std::vector<Match> out;
  out.reserve(matches.size());
  for (const DescriptorMatch& match : matches) {
    if (match.source >= source.size() || match.target >= target.size()) {
      throw InputError("matched_points: a match joins the points " + std::to_string(match.source) +
                       " of the source and " + std::to_string(match.target) + " of the target, which have " +
                       std::to_string(source.size()) + " and " + std::to_string(target.size()) +
                       " points: pass the clouds that were described, target first");
    }
    out.push_back({from.points[match.source], to.points[match.target], from.normals[match.source],
                   to.normals[match.target]});
  }
  return out;
}

}  // namespace loopwise
