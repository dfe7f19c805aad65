// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace loopwise {

/// Disjoint sets of the numbers 0 to n − 1 that can be joined: union-find with path halving (Tarjan & van
/// Leeuwen 1984). The smallest number identifies a set.
class DisjointSets {
 public:
  /// Each of n numbers is initially a set of its own.
  explicit DisjointSets(std::size_t n) : parent_(n) {
    std::iota(parent_.begin(), parent_.end(), std::uint32_t{0});
  }

  /// Adds one more number as a set of its own.
  void add() { parent_.push_back(static_cast<std::uint32_t>(parent_.size())); }

  /// The smallest number of the set that holds i.
  [[nodiscard]] std::uint32_t root(std::size_t i) {
    auto at = static_cast<std::uint32_t>(i);
    while (parent_[at] != at) at = parent_[at] = parent_[parent_[at]];
    return at;
  }

  /// Joins two sets. \returns whether they were separate
  bool join(std::size_t a, std::size_t b) {
    const std::uint32_t root_a = root(a), root_b = root(b);
    parent_[std::max(root_a, root_b)] = std::min(root_a, root_b);
    return root_a != root_b;
  }

 private:
  std::vector<std::uint32_t> parent_;
};

}  // namespace loopwise
