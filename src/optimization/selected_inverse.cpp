// SPDX-License-Identifier: BSD-3-Clause
#include "selected_inverse.hpp"

#include <algorithm>
#include <vector>

#include "blas.hpp"
#include "blas_threads.hpp"

namespace loopwise::detail {
namespace {

/// Panel that owns a column.
std::vector<int> owners(const Panels& panels) {
  std::vector<int> owner(panels.first.empty() ? 0 : static_cast<std::size_t>(panels.first.back()));
  for (std::size_t s = 0; s < panels.size(); ++s) {
    std::fill(owner.begin() + panels.first[s], owner.begin() + panels.first[s + 1], static_cast<int>(s));
  }
  return owner;
}

}  // namespace

Eigen::MatrixXd selected_inverse(const Panels& panels, int block,
                                 const std::function<void(std::size_t, const double*)>& visit) {
  const SingleThreadedBlas guard;
  const auto n = static_cast<Eigen::Index>(panels.first.empty() ? 0 : panels.first.back());
  Eigen::MatrixXd out(block, n);
  const std::vector<int> owner = owners(panels);

  // Z over all rows of a panel (its front) holds what its children need: their rows are among its rows.
  // Panels are in postorder, so going backwards a front is needed until the panels of its subtree, which
  // precede it, are done.
  struct Front {
    std::size_t panel;
    std::size_t first_of_subtree;
    std::vector<double> z;
  };
  std::vector<std::size_t> subtree(panels.size());
  for (std::size_t s = 0; s < panels.size(); ++s) subtree[s] = s;
  std::vector<int> parent(panels.size(), -1);
  for (std::size_t s = 0; s < panels.size(); ++s) {
    const int width = panels.columns(s);
    if (panels.height(s) == width) continue;
    const auto p = static_cast<std::size_t>(
        owner[static_cast<std::size_t>(panels.rows[panels.row_start[s] + static_cast<std::size_t>(width)])]);
    parent[s] = static_cast<int>(p);
    subtree[p] = std::min(subtree[p], subtree[s]);
  }

  std::vector<Front> stack;
  std::vector<double> spare, y;
  std::vector<int> place;
  for (std::size_t s = panels.size(); s-- > 0;) {
    while (!stack.empty() && stack.back().first_of_subtree > s) {
      spare.swap(stack.back().z);
      stack.pop_back();
    }
    const int width = panels.columns(s), height = panels.height(s), below = height - width;
    const auto h = static_cast<std::size_t>(height), w = static_cast<std::size_t>(width);
    const auto b = static_cast<std::size_t>(below);
    const double* l = panels.values.data() + panels.value_start[s];
    const int* rows = panels.rows.data() + panels.row_start[s];
    std::vector<double> z;
    z.swap(spare);
    z.resize(h * h);

    if (below > 0) {
      // Z_RR out of the parent's front.
      const Front& front = stack.back();
      const std::size_t p = front.panel;
      const int* parent_rows = panels.rows.data() + panels.row_start[p];
      const auto parent_height = static_cast<std::size_t>(panels.height(p));
      place.resize(b);
      for (std::size_t i = 0, at = 0; i < b; ++i) {
        while (parent_rows[at] != rows[w + i]) ++at;
        place[i] = static_cast<int>(at);
      }
      for (std::size_t j = 0; j < b; ++j) {
        const double* from = front.z.data() + static_cast<std::size_t>(place[j]) * parent_height;
        double* to = z.data() + (w + j) * h + w;
        for (std::size_t i = j; i < b; ++i) to[i] = from[place[i]];
      }
      // Y = L_RJ L_JJ⁻¹, Z_RJ = −Z_RR Y.
      y.resize(b * w);
      for (std::size_t j = 0; j < w; ++j) std::copy_n(l + j * h + w, b, y.data() + j * b);
      blas::trsm('R', 'N', below, width, l, height, y.data(), below);
      blas::symm(below, width, -1.0, z.data() + w * h + w, height, y.data(), below, 0.0, z.data() + w,
                 height);
    }
    // Z_JJ = L_JJ⁻ᵀ L_JJ⁻¹ − Yᵀ Z_RJ.
    for (std::size_t j = 0; j < w; ++j) {
      for (std::size_t i = 0; i < w; ++i) z[j * h + i] = i == j ? 1.0 : 0.0;
    }
    blas::trsm('L', 'N', width, width, l, height, z.data(), height);
    blas::trsm('L', 'T', width, width, l, height, z.data(), height);
    if (below > 0) {
      blas::gemm('T', 'N', width, width, below, -1.0, y.data(), below, z.data() + w, height, 1.0, z.data(),
                 height);
    }
    if (visit) visit(s, z.data());
    // A panel never splits a block: its columns continue each other's pattern.
    for (int column = 0; column < width; column += block) {
      out.middleCols(panels.first[s] + column, block) =
          Eigen::Map<const Eigen::MatrixXd, 0, Eigen::OuterStride<>>(
              z.data() + static_cast<std::size_t>(column) * (h + 1), block, block,
              Eigen::OuterStride<>(height));
    }
    if (subtree[s] < s) {
      stack.push_back({s, subtree[s], std::move(z)});
    } else {
      spare.swap(z);
    }
  }
  return out;
}

namespace {

enum class Direction { kForward, kBackward };

void substitute(const Panels& panels, Eigen::MatrixXd& x, Direction direction) {
  const auto columns = static_cast<int>(x.cols());
  Eigen::MatrixXd gathered;
  const auto visit = [&](std::size_t s) {
    const int width = panels.columns(s), height = panels.height(s), below = height - width;
    const double* l = panels.values.data() + panels.value_start[s];
    const int* rows = panels.rows.data() + panels.row_start[s] + width;
    double* top = x.data() + panels.first[s];
    const auto stride = static_cast<int>(x.rows());
    gathered.resize(below, columns);
    if (direction == Direction::kForward) {
      blas::trsm('L', 'N', width, columns, l, height, top, stride);
      blas::gemm('N', 'N', below, columns, width, 1.0, l + width, height, top, stride, 0.0, gathered.data(),
                 below);
      for (int c = 0; c < columns; ++c) {
        for (int r = 0; r < below; ++r) x(rows[r], c) -= gathered(r, c);
      }
    } else {
      for (int c = 0; c < columns; ++c) {
        for (int r = 0; r < below; ++r) gathered(r, c) = x(rows[r], c);
      }
      if (below > 0) {
        blas::gemm('T', 'N', width, columns, below, -1.0, l + width, height, gathered.data(), below, 1.0, top,
                   stride);
      }
      blas::trsm('L', 'T', width, columns, l, height, top, stride);
    }
  };
  if (direction == Direction::kForward) {
    for (std::size_t s = 0; s < panels.size(); ++s) visit(s);
  } else {
    for (std::size_t s = panels.size(); s-- > 0;) visit(s);
  }
}

}  // namespace

void solve(const Panels& panels, Eigen::MatrixXd& x) {
  const SingleThreadedBlas guard;
  substitute(panels, x, Direction::kForward);
  substitute(panels, x, Direction::kBackward);
}

void solve_transposed(const Panels& panels, Eigen::MatrixXd& x) {
  const SingleThreadedBlas guard;
  substitute(panels, x, Direction::kBackward);
}

}  // namespace loopwise::detail
