// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Arrays of a report's data as text, and samples of long ones.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <type_traits>
#include <vector>

#include <loopwise/core/random.hpp>

namespace loopwise {

inline std::string base64(const unsigned char* bytes, std::size_t count) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((count + 2) / 3 * 4);
  for (std::size_t i = 0; i < count; i += 3) {
    const std::size_t left = count - i;
    const unsigned word = (static_cast<unsigned>(bytes[i]) << 16) |
                          (left > 1 ? static_cast<unsigned>(bytes[i + 1]) << 8 : 0U) |
                          (left > 2 ? static_cast<unsigned>(bytes[i + 2]) : 0U);
    text += kDigits[word >> 18];
    text += kDigits[(word >> 12) & 63];
    text += left > 1 ? kDigits[(word >> 6) & 63] : '=';
    text += left > 2 ? kDigits[word & 63] : '=';
  }
  return text;
}

/// Little-endian, like the typed arrays of all common browsers.
template <class T>
std::string base64(const std::vector<T>& values) {
  static_assert(std::is_arithmetic_v<T>, "numbers");
  std::vector<unsigned char> bytes(values.size() * sizeof(T));
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::array<unsigned char, sizeof(T)> raw{};
    std::memcpy(raw.data(), &values[i], sizeof(T));
    const std::uint16_t one = 1;
    unsigned char first = 0;
    std::memcpy(&first, &one, 1);
    if (first == 0) std::reverse(raw.begin(), raw.end());
    std::copy(raw.begin(), raw.end(), bytes.begin() + static_cast<std::ptrdiff_t>(i * sizeof(T)));
  }
  return base64(bytes.data(), bytes.size());
}

/// Positions of at most `limit` of `total` items, ascending; all sets are equally likely (Knuth's algorithm
/// S).
inline std::vector<std::size_t> drawn(std::size_t total, std::int64_t limit, std::uint64_t seed) {
  const auto most = std::min(total, static_cast<std::size_t>(limit));
  std::vector<std::size_t> chosen;
  chosen.reserve(most);
  Rng rng(seed);
  for (std::size_t i = 0; i < total && chosen.size() < most; ++i) {
    if (rng.below(total - i) < most - chosen.size()) chosen.push_back(i);
  }
  return chosen;
}

}  // namespace loopwise
