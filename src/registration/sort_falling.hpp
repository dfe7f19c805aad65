// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

namespace loopwise {

/// Sorts by falling `value(item)`; equal items keep their order. Items may have any alignment.
/// std::stable_sort of libstdc++ has a buffer with the alignment of malloc, which is too little for Eigen's
/// types with -march=native.
template <class Item, class Value>
void sort_falling(std::vector<Item>& items, const Value& value) {
  std::vector<std::size_t> order(items.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return value(items[a]) > value(items[b]); });
  std::vector<Item> sorted;
  sorted.reserve(items.size());
  for (const std::size_t i : order) sorted.push_back(items[i]);
  items = std::move(sorted);
}

}  // namespace loopwise
