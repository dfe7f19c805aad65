// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/registration/matching.hpp>

namespace loopwise {

/// Descriptors as 16-bit integers with 2^14 for 1, in the order in which the comparison of all pairs reads
/// them: blocks of kBlock descriptors, within a block pairs of components, within a pair the block's
/// descriptors. Sums of integers are exact in any order, and four times as fast as floats on every x86-64.
class PackedDescriptors {
 public:
  static constexpr std::size_t kBlock = 8;
  static constexpr std::size_t kPairs = (kFpfhSize + 1) / 2;

  PackedDescriptors() = default;
  explicit PackedDescriptors(const Descriptors& descriptors);

  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::size_t blocks() const { return (size_ + kBlock - 1) / kBlock; }
  /// 2·kBlock numbers for each pair of components. Descriptors past the end are zero.
  [[nodiscard]] const std::int16_t* block(std::size_t b) const {
    return packed_.data() + b * kPairs * 2 * kBlock;
  }
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + packed_.capacity() * sizeof(std::int16_t);
  }

 private:
  std::size_t size_ = 0;
  std::vector<std::int16_t> packed_;
};

/// One match for each source descriptor, in their order; the first of equal ones. Empty if a side is empty.
/// \param portable does without instructions that only some processors have; the result is the same
[[nodiscard]] std::vector<DescriptorMatch> most_similar(const PackedDescriptors& target,
                                                        const PackedDescriptors& source,
                                                        bool portable = false);

/// The first `max_matches` of the order of match_descriptors().
[[nodiscard]] std::vector<DescriptorMatch> best_matches(std::vector<DescriptorMatch> matches,
                                                        std::size_t max_matches);

}  // namespace loopwise
