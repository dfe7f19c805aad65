// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace loopwise {

/// A square matrix of bits with rows of whole words. It stores a relation of n items with one bit per pair.
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
  /// Row i as words() words. Column 0 is the lowest bit of the first word.
  [[nodiscard]] const std::uint64_t* row(std::size_t i) const { return bits_.data() + i * words_; }
  /// Number of words per row.
  [[nodiscard]] std::size_t words() const { return words_; }

 private:
  std::size_t words_;
  std::vector<std::uint64_t> bits_;
};

}  // namespace loopwise
