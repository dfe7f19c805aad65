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
  std::uint64_t high = 0;  ///< The first 64 bits.
  std::uint64_t low = 0;   ///< The other 64 bits.

  /// Whether both stand for the same content.
  friend bool operator==(const ContentHash& a, const ContentHash& b) {
    return a.high == b.high && a.low == b.low;
  }
  /// Whether they stand for different contents.
  friend bool operator!=(const ContentHash& a, const ContentHash& b) { return !(a == b); }
  /// An order for sorted containers; it means nothing else.
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
  /// Takes in `size` bytes as they lie in memory.
  ContentHasher& bytes(const void* data, std::size_t size);
  /// Takes in a text, its length first.
  ContentHasher& text(std::string_view value);
  /// Takes in the number's eight bytes as they lie in memory.
  ContentHasher& integer(std::uint64_t value) { return bytes(&value, sizeof value); }
  /// By its bits: 0.0 and −0.0 are two numbers.
  ContentHasher& number(double value) { return bytes(&value, sizeof value); }

  /// The hash of all that was taken in so far; more may follow.
  [[nodiscard]] ContentHash finish() const;

 private:
  void mix_block(const unsigned char* block);

  std::uint64_t high_ = 0, low_ = 0;
  std::uint64_t size_ = 0;
  unsigned char tail_[16] = {};  // size_ % 16 bytes wait here
};

}  // namespace loopwise

/// A hash as the key of unordered containers.
template <>
struct std::hash<loopwise::ContentHash> {
  /// Folds the 128 bits into one word.
  std::size_t operator()(const loopwise::ContentHash& value) const noexcept {
    return static_cast<std::size_t>(value.high ^ value.low);
  }
};
