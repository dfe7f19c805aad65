// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>

namespace loopwise::detail {

/// Numbers of two variables, which are block rows and columns of a matrix.
using BlockPair = std::pair<std::uint32_t, std::uint32_t>;

/// One triangle of a symmetric matrix of blocks: rows[start[v]] … of block column v, ascending.
struct BlockPattern {
  std::vector<std::size_t> start;
  std::vector<std::uint32_t> rows;

  [[nodiscard]] std::size_t columns() const { return start.size() - 1; }
};

/// Lower triangle of a matrix with these off-diagonal blocks, the diagonal included, after renumbering the
/// variables by `position`. Pairs may repeat, in either direction.
[[nodiscard]] LOOPWISE_EXPORT BlockPattern lower_pattern(const std::vector<BlockPair>& pairs,
                                                         const std::vector<std::uint32_t>& position);
/// The other triangle of the same matrix.
[[nodiscard]] BlockPattern transposed(const BlockPattern& pattern);

/// A symmetric matrix of square blocks. One of the blocks (a, b) and (b, a) is stored.
class LOOPWISE_EXPORT BlockMatrix {
 public:
  /// Position of a block among the values: element (r, c) at offset + c·stride + r, or transposed.
  struct Slot {
    std::size_t offset = 0;
    std::uint32_t stride = 0;
    bool transposed = false;
  };
  /// Order of the values.
  enum class Layout {
    kBlocks,   ///< One block after the other, each column-major.
    kColumns,  ///< Scalar columns, as CHOLMOD reads them.
  };

  explicit BlockMatrix(int block_size) : block_(block_size) {}

  /// Blocks by variable, then by pair: pairs that repeat have a block each. In the order of the variables.
  /// The values are undefined.
  void lay_out(std::size_t variables, const std::vector<BlockPair>& pairs);
  /// Blocks by column of a pattern of the renumbered variables. The values are undefined.
  /// \param lower whether the pattern is the lower triangle. \throws Error if there are too many values
  void lay_out(const BlockPattern& pattern, bool lower, const std::vector<std::uint32_t>& position,
               const std::vector<BlockPair>& pairs, Layout layout);

  [[nodiscard]] int block_size() const { return block_; }
  [[nodiscard]] std::size_t variables() const { return diagonal_slots_.size(); }
  /// As given to lay_out().
  [[nodiscard]] const std::vector<BlockPair>& pairs() const { return pairs_; }
  /// Slot of pair k, seen as block (first, second).
  [[nodiscard]] const Slot& pair_slot(std::size_t k) const { return pair_slots_[k]; }
  [[nodiscard]] const Slot& diagonal_slot(std::size_t variable) const { return diagonal_slots_[variable]; }
  /// Block column of the values that holds pair k; variable v is at position(v).
  [[nodiscard]] std::uint32_t pair_column(std::size_t k) const { return pair_columns_[k]; }
  [[nodiscard]] std::uint32_t position(std::size_t variable) const { return position_[variable]; }

  [[nodiscard]] std::vector<double>& values() { return values_; }
  [[nodiscard]] const std::vector<double>& values() const { return values_; }
  void set_zero();
  [[nodiscard]] Eigen::VectorXd diagonal() const;
  void set_diagonal(const Eigen::VectorXd& diagonal);

  /// Adds to the block of a slot, which is square.
  template <class Block>
  void add(const Slot& slot, const Eigen::MatrixBase<Block>& block) {
    double* to = values_.data() + slot.offset;
    const Eigen::Index size = block.rows();
    for (Eigen::Index c = 0; c < size; ++c, to += slot.stride) {
      if (slot.transposed) {
        for (Eigen::Index r = 0; r < size; ++r) to[r] += block(c, r);
      } else {
        for (Eigen::Index r = 0; r < size; ++r) to[r] += block(r, c);
      }
    }
  }
  /// Takes the values of a matrix of 6×6 blocks over the same variables in the layout by variable. Its pairs
  /// are the first ones here; all other blocks become 0. \pre Layout::kBlocks
  void assign(const BlockMatrix& other);

 private:
  int block_;
  std::vector<BlockPair> pairs_;
  std::vector<std::uint32_t> position_;
  std::vector<Slot> pair_slots_, diagonal_slots_;
  std::vector<std::uint32_t> pair_columns_;
  std::vector<double> values_;
};

}  // namespace loopwise::detail
