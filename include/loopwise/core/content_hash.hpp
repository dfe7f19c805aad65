// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <tuple>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// 128 bits that stand for some content. Equal content has equal hashes; that two different contents have is
/// not to be expected among any number that fits on a disk. No protection against malice.
struct ContentHash {
  std::uint64_t high = 0;
  std::uint64_t low = 0;

  friend bool operator==(const ContentHash& a, const ContentHash& b) {
    return a.high == b.high && a.low == b.low;
  }
  friend bool operator!=(const ContentHash& a, const ContentHash& b) { return !(a == b); }
  friend bool operator<(const ContentHash& a, const ContentHash& b) {
    return std::tie(a.high, a.low) < std::tie(b.high, b.low);
  }
};

/// 32 hexadecimal digits.
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const ContentHash& hash);

/// MurmurHash3 (x64, 128 bits, seed 0; Appleby 2011) of all that it is given, in pieces of any size. The
/// pieces' borders do not count: put a length before what varies in length, as text() does.
class LOOPWISE_EXPORT ContentHasher {
 public:
  ContentHasher& bytes(const void* data, std::size_t size);
  ContentHasher& text(std::string_view value);
  ContentHasher& integer(std::uint64_t value) { return bytes(&value, sizeof value); }
  /// By its bits: 0.0 and −0.0 are two numbers.
  ContentHasher& number(double value) { return bytes(&value, sizeof value); }

  [[nodiscard]] ContentHash finish() const;

 private:
  void mix_block(const unsigned char* block);

  std::uint64_t high_ = 0, low_ = 0;
  std::uint64_t size_ = 0;
  unsigned char tail_[16] = {};  // size_ % 16 bytes wait here
};

}  // namespace loopwise

template <>
struct std::hash<loopwise::ContentHash> {
  std::size_t operator()(const loopwise::ContentHash& value) const noexcept {
    return static_cast<std::size_t>(value.high ^ value.low);
  }
};
