// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "block_matrix.hpp"

namespace loopwise::detail {

/// Symbolic analysis of the Cholesky factor L of a symmetric matrix of blocks: the order of elimination, the
/// elimination tree, and the number of blocks in each column of L. The order is a postorder of the tree, so
/// that columns of a subtree are neighbours.
struct Elimination {
  std::vector<std::uint32_t> position;  ///< By variable.
  std::vector<int> parent;              ///< By position, -1 for a root.
  std::vector<int> count;               ///< By position, the diagonal block included.
  BlockPattern lower;                   ///< Of the matrix, by position.

  /// Squared counts, summed: proportional to the operations of a factorisation.
  [[nodiscard]] double work() const;
};

/// Analyses the matrix in an order close to `order`, which lists all variables: only columns of different
/// branches of the tree change places.
[[nodiscard]] Elimination analyze_order(const std::vector<std::uint32_t>& order,
                                        const std::vector<BlockPair>& pairs);

/// Whether an order by nested dissection is tried.
enum class Dissection { kNever, kIfLong };

/// Analyses the matrix in a fill-reducing order: approximate minimum degree, or nested dissection where that
/// is allowed, better, and the factorisation is long enough to pay for it. Pairs may repeat, in either
/// direction. \throws Error if the graph has too many nodes or edges for one analysis
[[nodiscard]] Elimination fill_reducing_elimination(std::size_t variables,
                                                    const std::vector<BlockPair>& pairs, int block_size,
                                                    Dissection dissection);

}  // namespace loopwise::detail
