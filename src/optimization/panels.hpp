// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

namespace loopwise::detail {

/// L of a factorisation as dense panels. Panel s holds columns first[s] … first[s+1]−1 of L in the rows
/// rows[row_start[s]] …, column by column from values[value_start[s]], with the square diagonal part at the
/// top.
struct Panels {
  std::vector<int> first;
  std::vector<std::size_t> row_start;
  std::vector<std::size_t> value_start;
  std::vector<int> rows;
  std::vector<double> values;  ///< Entries above the diagonal of the square part are undefined.

  [[nodiscard]] std::size_t size() const { return first.empty() ? 0 : first.size() - 1; }
  [[nodiscard]] int columns(std::size_t s) const { return first[s + 1] - first[s]; }
  [[nodiscard]] int height(std::size_t s) const { return static_cast<int>(row_start[s + 1] - row_start[s]); }
};

}  // namespace loopwise::detail
