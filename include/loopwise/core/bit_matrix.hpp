// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace loopwise {

/// A square matrix of bits, rows of whole words: a relation of n things, one bit a pair.
class BitMatrix {
 public:
  /// All bits are 0.
  explicit BitMatrix(std::size_t n) : words_((n + 63) / 64), bits_(n * words_, 0) {}

  /// Makes a bit 1.
  void set(std::size_t i, std::size_t j) { bits_[i * words_ + j / 64] |= std::uint64_t{1} << (j % 64); }
  /// Whether a bit is 1.
  [[nodiscard]] bool get(std::size_t i, std::size_t j) const {
    return (bits_[i * words_ + j / 64] >> (j % 64)) & 1U;
  }
  /// Row i: words() words, column 0 in the lowest bit of the first.
  [[nodiscard]] const std::uint64_t* row(std::size_t i) const { return bits_.data() + i * words_; }
  /// Words of a row.
  [[nodiscard]] std::size_t words() const { return words_; }

 private:
  std::size_t words_;
  std::vector<std::uint64_t> bits_;
};

}  // namespace loopwise
