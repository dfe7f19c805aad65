// SPDX-License-Identifier: BSD-3-Clause
#include "block_matrix.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

#include <loopwise/core/error.hpp>

namespace loopwise::detail {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// Rows of each column from columns of each row; ascending if the rows are visited in order.
BlockPattern turned(const BlockPattern& by_row) {
  const std::size_t n = by_row.columns();
  BlockPattern out;
  out.start.assign(n + 1, 0);
  out.rows.resize(by_row.rows.size());
  for (const std::uint32_t c : by_row.rows) ++out.start[c + 1];
  std::partial_sum(out.start.begin(), out.start.end(), out.start.begin());
  std::vector<std::size_t> next(out.start.begin(), out.start.end() - 1);
  for (std::uint32_t r = 0; r < n; ++r) {
    for (std::size_t p = by_row.start[r]; p < by_row.start[r + 1]; ++p) out.rows[next[by_row.rows[p]]++] = r;
  }
  return out;
}

}  // namespace

BlockPattern lower_pattern(const std::vector<BlockPair>& pairs, const std::vector<std::uint32_t>& position) {
  const std::size_t n = position.size();
  BlockPattern by_row;
  by_row.start.assign(n + 1, 1);  // the diagonal
  by_row.start[0] = 0;
  const auto row_and_column = [&](const BlockPair& pair) {
    const std::uint32_t a = position[pair.first], b = position[pair.second];
    return a < b ? BlockPair(b, a) : BlockPair(a, b);
  };
  for (const BlockPair& pair : pairs) ++by_row.start[row_and_column(pair).first + 1];
  std::partial_sum(by_row.start.begin(), by_row.start.end(), by_row.start.begin());
  by_row.rows.resize(by_row.start.back());
  std::vector<std::size_t> next(by_row.start.begin(), by_row.start.end() - 1);
  for (std::uint32_t v = 0; v < n; ++v) by_row.rows[next[v]++] = v;
  for (const BlockPair& pair : pairs) {
    const auto [row, column] = row_and_column(pair);
    by_row.rows[next[row]++] = column;
  }
  BlockPattern out = turned(by_row);
  // Repeated pairs are neighbours now.
  std::size_t to = 0;
  for (std::size_t v = 0, from = 0; v < n; ++v) {
    const std::size_t begin = to;
    for (; from < out.start[v + 1]; ++from) {
      if (to == begin || out.rows[to - 1] != out.rows[from]) out.rows[to++] = out.rows[from];
    }
    out.start[v] = begin;
  }
  out.start[n] = to;
  out.rows.resize(to);
  return out;
}

BlockPattern transposed(const BlockPattern& pattern) {
  return turned(pattern);
}

void BlockMatrix::lay_out(std::size_t variables, const std::vector<BlockPair>& pairs) {
  const auto block = static_cast<std::size_t>(block_);
  const auto stride = static_cast<std::uint32_t>(block_);
  pairs_ = pairs;
  position_.resize(variables);
  std::iota(position_.begin(), position_.end(), 0U);
  diagonal_slots_.resize(variables);
  for (std::size_t v = 0; v < variables; ++v) diagonal_slots_[v] = {block * block * v, stride, false};
  pair_slots_.resize(pairs.size());
  pair_columns_.resize(pairs.size());
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    pair_slots_[k] = {block * block * (variables + k), stride, false};
    pair_columns_[k] = pairs[k].second;
  }
  values_.resize(block * block * (variables + pairs.size()));
}

void BlockMatrix::lay_out(const BlockPattern& pattern, bool lower, const std::vector<std::uint32_t>& position,
                          const std::vector<BlockPair>& pairs, Layout layout) {
  const auto block = static_cast<std::size_t>(block_);
  if (pattern.rows.size() * block * block > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    throw Error("the graph has too many edges for one factorisation");
  }
  pairs_ = pairs;
  position_ = position;
  values_.resize(pattern.rows.size() * block * block);
  const bool blocks = layout == Layout::kBlocks;
  const auto slot = [&](std::uint32_t row, std::uint32_t column) {
    const auto begin = pattern.rows.begin() + static_cast<std::ptrdiff_t>(pattern.start[column]);
    const auto end = pattern.rows.begin() + static_cast<std::ptrdiff_t>(pattern.start[column + 1]);
    const auto index = static_cast<std::size_t>(std::lower_bound(begin, end, row) - begin);
    Slot s;
    s.offset = block * block * pattern.start[column] + index * (blocks ? block * block : block);
    s.stride = static_cast<std::uint32_t>(blocks ? block : static_cast<std::size_t>(end - begin) * block);
    return s;
  };
  diagonal_slots_.resize(position.size());
  for (std::size_t v = 0; v < position.size(); ++v) diagonal_slots_[v] = slot(position[v], position[v]);
  pair_slots_.resize(pairs.size());
  pair_columns_.resize(pairs.size());
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const std::uint32_t a = position[pairs[k].first], b = position[pairs[k].second];
    const bool in_order = lower ? a > b : a < b;
    pair_slots_[k] = in_order ? slot(a, b) : slot(b, a);
    pair_slots_[k].transposed = !in_order;
    pair_columns_[k] = in_order ? b : a;
  }
}

void BlockMatrix::set_zero() {
  std::fill(values_.begin(), values_.end(), 0.0);
}

Eigen::VectorXd BlockMatrix::diagonal() const {
  Eigen::VectorXd d(static_cast<Eigen::Index>(variables()) * block_);
  for (std::size_t v = 0; v < variables(); ++v) {
    const Slot& slot = diagonal_slots_[v];
    for (int k = 0; k < block_; ++k) {
      d[static_cast<Eigen::Index>(v) * block_ + k] =
          values_[slot.offset + static_cast<std::size_t>(k) * (slot.stride + 1)];
    }
  }
  return d;
}

void BlockMatrix::set_diagonal(const Eigen::VectorXd& diagonal) {
  for (std::size_t v = 0; v < variables(); ++v) {
    const Slot& slot = diagonal_slots_[v];
    for (int k = 0; k < block_; ++k) {
      values_[slot.offset + static_cast<std::size_t>(k) * (slot.stride + 1)] =
          diagonal[static_cast<Eigen::Index>(v) * block_ + k];
    }
  }
}

void BlockMatrix::assign(const BlockMatrix& other) {
  std::vector<char> written(values_.size() / 36, 0);
  const auto take = [&](const Slot& slot, const Slot& from) {
    const double* block = other.values_.data() + from.offset;
    double* to = values_.data() + slot.offset;
    char& is_written = written[slot.offset / 36];
    if (is_written != 0) {
      add(slot, Eigen::Map<const Matrix6>(block));
    } else if (slot.transposed) {
      Eigen::Map<Matrix6> copy(to);
      copy = Eigen::Map<const Matrix6>(block).transpose();
    } else {
      std::copy_n(block, 36, to);
    }
    is_written = 1;
  };
  for (std::size_t v = 0; v < variables(); ++v) take(diagonal_slots_[v], other.diagonal_slots_[v]);
  for (std::size_t k = 0; k < other.pairs_.size(); ++k) take(pair_slots_[k], other.pair_slots_[k]);
  for (std::size_t block = 0; block < written.size(); ++block) {
    if (written[block] == 0) std::fill_n(values_.begin() + static_cast<std::ptrdiff_t>(36 * block), 36, 0.0);
  }
}

}  // namespace loopwise::detail
