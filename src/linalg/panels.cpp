// SPDX-License-Identifier: BSD-3-Clause
#include "panels.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace loopwise::detail {
namespace {

/// Inverse of the lower triangle of a 6×6 block by rows; 0 above.
/// \param stride of the columns of `l`
void invert_block(const double* l, std::size_t stride, double* inverse) {
  double pivot[6];
  for (std::size_t i = 0; i < 6; ++i) pivot[i] = 1.0 / l[i * (stride + 1)];
  for (std::size_t i = 0; i < 6; ++i) {
    // All columns at a time, which the compiler turns into vectors.
    double row[6] = {};
    for (std::size_t k = 0; k < i; ++k) {
      const double factor = l[k * stride + i];
      for (std::size_t j = 0; j < 6; ++j) row[j] -= factor * inverse[6 * k + j];
    }
    row[i] = 1.0;
    for (std::size_t j = 0; j < 6; ++j) inverse[6 * i + j] = row[j] * pivot[i];
  }
}

/// Widths of the kernels, and the one that takes the most of a number of columns.
int kernel_width(Eigen::Index columns) {
  for (const int width : {6, 12, 16}) {
    if (columns <= width) return width;
  }
  return 24;
}

enum class Direction { kBoth, kBackward };

/// The kernels take row-major blocks of a few columns.
void substitute(const Panels& l, Eigen::MatrixXd& x, Direction direction) {
  const DenseKernels& kernels = dense_kernels(Rounding::kFastest);
  const PanelView view = l.view();
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> some;
  for (Eigen::Index at = 0; at < x.cols();) {
    const int width = kernel_width(x.cols() - at);
    const Eigen::Index used = std::min<Eigen::Index>(width, x.cols() - at);
    some.setZero(x.rows(), width);
    some.leftCols(used) = x.middleCols(at, used);
    if (direction == Direction::kBoth) kernels.forward(view, nullptr, 0, width, some.data());
    kernels.backward(view, width, some.data());
    x.middleCols(at, used) = some.leftCols(used);
    at += used;
  }
}

}  // namespace

void invert_diagonal(Panels& l) {
  l.inverse.resize(36 * l.block_columns());
  for (std::size_t s = 0; s < l.size(); ++s) {
    const auto height = static_cast<std::size_t>(l.height(s));
    const double* block = l.values.data() + l.value_start[s];
    for (std::uint32_t v = l.first[s]; v < l.first[s + 1]; ++v, block += 6 * (height + 1)) {
      invert_block(block, height, l.inverse.data() + 36 * std::size_t{v});
    }
  }
}

double log_determinant(const Panels& l) {
  double sum = 0.0;
  for (std::size_t s = 0; s < l.size(); ++s) {
    const auto height = static_cast<std::size_t>(l.height(s));
    for (std::size_t j = 0; j < static_cast<std::size_t>(l.columns(s)); ++j) {
      sum += 2.0 * std::log(l.values[l.value_start[s] + j * (height + 1)]);
    }
  }
  return sum;
}

void solve(const Panels& l, Eigen::MatrixXd& x) {
  substitute(l, x, Direction::kBoth);
}

void solve_transposed(const Panels& l, Eigen::MatrixXd& x) {
  substitute(l, x, Direction::kBackward);
}

std::vector<PathStep> sparse_path(const Panels& l, std::vector<std::uint32_t> columns) {
  // The columns move up their paths, the lowest one first. Columns of one panel continue together.
  std::vector<PathStep> path;
  while (!columns.empty()) {
    const std::uint32_t lowest = *std::min_element(columns.begin(), columns.end());
    const std::uint32_t s = l.owner[lowest];
    path.push_back({s, lowest - l.first[s]});
    const std::uint32_t end = l.first[s + 1];
    columns.erase(std::remove_if(columns.begin(), columns.end(), [&](std::uint32_t c) { return c < end; }),
                  columns.end());
    if (l.row_start[s + 1] > l.row_start[s]) columns.push_back(l.rows[l.row_start[s]]);
  }
  return path;
}

SparseInverse::SparseInverse(Panels l) : l_(std::move(l)), x_(36 * l_.block_columns(), 0.0) {
  invert_diagonal(l_);
}

Matrix6d SparseInverse::between(const std::vector<Block>& b) {
  using RowMajor = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
  std::vector<std::uint32_t> columns;
  for (const Block& block : b) {
    columns.push_back(block.column);
    Eigen::Map<RowMajor>(x_.data() + 36 * std::size_t{block.column}) += block.value;
  }
  const std::vector<PathStep> path = sparse_path(l_, std::move(columns));
  const DenseKernels& kernels = dense_kernels(Rounding::kFastest);
  kernels.forward(l_.view(), path.data(), path.size(), 6, x_.data());
  Matrix6d sum = Matrix6d::Zero();
  for (const PathStep& step : path) {
    const std::size_t begin = l_.first[step.panel] + std::size_t{step.column};
    const std::size_t count = l_.first[step.panel + 1] - begin;
    RowMajor part;
    kernels.gram(x_.data() + 36 * begin, count, 6, 6, part.data());
    sum += part;
    std::fill_n(x_.begin() + static_cast<std::ptrdiff_t>(36 * begin), 36 * count, 0.0);
  }
  return sum;
}

}  // namespace loopwise::detail
