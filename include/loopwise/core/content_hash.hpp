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

/// 128 bits that identify some content. Equal content has equal hashes. Collisions are not expected among any
/// number of contents that fits on a disk. The hash does not protect against malicious input.
struct ContentHash {
  std::uint64_t high = 0;  ///< The first 64 bits.
  std::uint64_t low = 0;   ///< The other 64 bits.

  /// Whether both identify the same content.
  friend bool operator==(const ContentHash& a, const ContentHash& b) {
    return a.high == b.high && a.low == b.low;
  }
  /// Whether they identify different contents.
  friend bool operator!=(const ContentHash& a, const ContentHash& b) { return !(a == b); }
  /// An order for sorted containers, without further meaning.
  friend bool operator<(const ContentHash& a, const ContentHash& b) {
    return std::tie(a.high, a.low) < std::tie(b.high, b.low);
  }
};

/// 32 hexadecimal digits.
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const ContentHash& hash);

/// MurmurHash3 (x64, 128 bits, seed 0; Appleby 2011) of all input, in pieces of any size. The hash does not
/// depend on the division into pieces. So add a length before items of variable length, as text() does.
class LOOPWISE_EXPORT ContentHasher {
 public:
  /// Adds `size` bytes of memory.
  ContentHasher& bytes(const void* data, std::size_t size);
  /// Adds a text, its length first.
  ContentHasher& text(std::string_view value);
  /// Adds the number's eight bytes in memory order.
  ContentHasher& integer(std::uint64_t value) { return bytes(&value, sizeof value); }
  /// Adds the bits of a number: 0.0 and −0.0 differ.
  ContentHasher& number(double value) { return bytes(&value, sizeof value); }

  /// The hash of the input so far; more may follow.
  [[nodiscard]] ContentHash finish() const;

 private:
  void mix_block(const unsigned char* block);

  std::uint64_t high_ = 0, low_ = 0;
  std::uint64_t size_ = 0;
  unsigned char tail_[16] = {};  // the last size_ % 16 bytes, which are not hashed yet
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
