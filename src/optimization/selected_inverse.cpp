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

/// Z = (L Lᵀ)⁻¹ over all rows of a panel. The panel's children need it, because their rows are among its
/// rows.
struct Front {
  std::size_t panel;
  std::size_t first_of_subtree;
  std::vector<double> z;
};

/// First panel of each panel's subtree.
std::vector<std::size_t> first_of_subtrees(const Panels& panels) {
  const std::vector<int> owner = owners(panels);
  std::vector<std::size_t> subtree(panels.size());
  for (std::size_t s = 0; s < panels.size(); ++s) subtree[s] = s;
  for (std::size_t s = 0; s < panels.size(); ++s) {
    const int width = panels.columns(s);
    if (panels.height(s) == width) continue;
    const auto p = static_cast<std::size_t>(
        owner[static_cast<std::size_t>(panels.rows[panels.row_start[s] + static_cast<std::size_t>(width)])]);
    subtree[p] = std::min(subtree[p], subtree[s]);
  }
  return subtree;
}

/// Computes the fronts of the panels one by one, from the last to the first.
class Fronts {
 public:
  explicit Fronts(const Panels& panels) : panels_(panels) {}

  /// Computes Z over all rows and columns of a panel's front; `parent` is the front above, or null for a
  /// root.
  void compute(std::size_t s, const Front* parent, std::vector<double>& z) {
    const int width = panels_.columns(s), height = panels_.height(s), below = height - width;
    const auto h = static_cast<std::size_t>(height), w = static_cast<std::size_t>(width);
    const double* l = panels_.values.data() + panels_.value_start[s];
    z.resize(h * h);
    if (below > 0) {
      take_from_parent(s, *parent, z);
      // Y = L_RJ L_JJ⁻¹, Z_RJ = −Z_RR Y.
      const auto b = static_cast<std::size_t>(below);
      y_.resize(b * w);
      for (std::size_t j = 0; j < w; ++j) std::copy_n(l + j * h + w, b, y_.data() + j * b);
      blas::trsm('R', 'N', below, width, l, height, y_.data(), below);
      blas::symm(below, width, -1.0, z.data() + w * h + w, height, y_.data(), below, 0.0, z.data() + w,
                 height);
    }
    // Z_JJ = L_JJ⁻ᵀ L_JJ⁻¹ − Yᵀ Z_RJ.
    for (std::size_t j = 0; j < w; ++j) {
      for (std::size_t i = 0; i < w; ++i) z[j * h + i] = i == j ? 1.0 : 0.0;
    }
    blas::trsm('L', 'N', width, width, l, height, z.data(), height);
    blas::trsm('L', 'T', width, width, l, height, z.data(), height);
    if (below > 0) {
      blas::gemm('T', 'N', width, width, below, -1.0, y_.data(), below, z.data() + w, height, 1.0, z.data(),
                 height);
    }
  }

 private:
  /// Copies Z_RR from the parent's front.
  void take_from_parent(std::size_t s, const Front& parent, std::vector<double>& z) {
    const auto h = static_cast<std::size_t>(panels_.height(s)),
               w = static_cast<std::size_t>(panels_.columns(s));
    const std::size_t b = h - w;
    const int* rows = panels_.rows.data() + panels_.row_start[s];
    const int* parent_rows = panels_.rows.data() + panels_.row_start[parent.panel];
    const auto parent_height = static_cast<std::size_t>(panels_.height(parent.panel));
    place_.resize(b);
    for (std::size_t i = 0, at = 0; i < b; ++i) {
      while (parent_rows[at] != rows[w + i]) ++at;
      place_[i] = static_cast<int>(at);
    }
    for (std::size_t j = 0; j < b; ++j) {
      const double* from = parent.z.data() + static_cast<std::size_t>(place_[j]) * parent_height;
      double* to = z.data() + (w + j) * h + w;
      for (std::size_t i = j; i < b; ++i) to[i] = from[place_[i]];
    }
  }

  const Panels& panels_;
  std::vector<double> y_;
  std::vector<int> place_;
};

}  // namespace

Eigen::MatrixXd selected_inverse(const Panels& panels, int block,
                                 const std::function<void(std::size_t, const double*)>& visit) {
  const SingleThreadedBlas guard;
  const auto n = static_cast<Eigen::Index>(panels.first.empty() ? 0 : panels.first.back());
  Eigen::MatrixXd out(block, n);
  // Panels are in postorder and are visited backwards, so a front is needed until all panels of its subtree,
  // which precede it, are done.
  const std::vector<std::size_t> subtree = first_of_subtrees(panels);
  Fronts fronts(panels);
  std::vector<Front> stack;
  std::vector<double> spare;
  for (std::size_t s = panels.size(); s-- > 0;) {
    while (!stack.empty() && stack.back().first_of_subtree > s) {
      spare.swap(stack.back().z);
      stack.pop_back();
    }
    const int width = panels.columns(s), height = panels.height(s);
    std::vector<double> z;
    z.swap(spare);
    fronts.compute(s, stack.empty() ? nullptr : &stack.back(), z);
    if (visit) visit(s, z.data());
    // A panel never splits a block: all columns of a block have the same pattern.
    for (int column = 0; column < width; column += block) {
      out.middleCols(panels.first[s] + column, block) =
          Eigen::Map<const Eigen::MatrixXd, 0, Eigen::OuterStride<>>(
              z.data() + static_cast<std::size_t>(column) * static_cast<std::size_t>(height + 1), block,
              block, Eigen::OuterStride<>(height));
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
