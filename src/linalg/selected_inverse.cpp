// SPDX-License-Identifier: BSD-3-Clause
#include "selected_inverse.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "blas.hpp"
#include "blas_threads.hpp"
#include "front.hpp"

namespace loopwise::detail {
namespace {

/// Panels of at least this many rows are inverted by BLAS. It reads a large front once, and the kernels once
/// for each block column. Bounds of 256 to 512 rows take the same time; lattices take twice as long without
/// BLAS.
constexpr int kBlasHeight = 256;

/// Z = (L Lᵀ)⁻¹ over all rows of a panel, both triangles. The panel's children need it, because their rows
/// are among its rows.
struct Front {
  std::size_t panel;
  std::vector<double> z;
};

/// First of each panel's children; the panel itself if it has none.
std::vector<std::size_t> first_children(const Panels& l) {
  std::vector<std::size_t> first(l.size());
  for (std::size_t s = 0; s < l.size(); ++s) first[s] = s;
  for (std::size_t s = l.size(); s-- > 0;) {
    if (l.parent[s] >= 0) first[static_cast<std::size_t>(l.parent[s])] = s;
  }
  return first;
}

/// Computes the fronts of the panels one by one, from the last to the first.
class Fronts {
 public:
  Fronts(const Panels& l, Rounding rounding) : l_(l), arithmetic_(rounding) {}

  /// Computes Z over all rows and columns of a panel's front; `parent` is the front above, or null for a
  /// root.
  void compute(std::size_t s, const Front* parent, std::vector<double>& z) {
    const auto h = static_cast<std::size_t>(l_.height(s));
    z.resize(h * h);
    if (parent != nullptr) take_from_parent(s, *parent, z.data());
    if (arithmetic_.blas && l_.height(s) >= kBlasHeight) {
      compute_by_blas(s, z.data());
      return;
    }
    const auto columns = static_cast<int>(l_.first[s + 1] - l_.first[s]);
    for (int j = columns - 1; j >= 0; --j) compute_column(s, j, z.data());
  }

 private:
  /// Copies the rows and columns below the panel's columns from the parent's front.
  void take_from_parent(std::size_t s, const Front& parent, double* z) {
    const auto h = static_cast<std::size_t>(l_.height(s)), w = static_cast<std::size_t>(l_.columns(s));
    const std::size_t p = parent.panel, stride = static_cast<std::size_t>(l_.height(p));
    const std::uint32_t first = l_.first[p], end = l_.first[p + 1];
    const std::uint32_t* parent_rows = l_.rows.data() + l_.row_start[p];
    place_.clear();
    std::size_t at = 0;
    for (std::size_t i = l_.row_start[s]; i < l_.row_start[s + 1]; ++i) {
      const std::uint32_t row = l_.rows[i];
      if (row < end) {
        place_.push_back(6 * std::size_t{row - first});
        continue;
      }
      while (parent_rows[at] != row) ++at;
      place_.push_back(6 * (std::size_t{end - first} + at));
    }
    double* to = z + w * h + w;
    for (const std::size_t column : place_) {
      for (std::size_t c = 0; c < 6; ++c, to += h) {
        const double* from = parent.z.data() + (column + c) * stride;
        double* block = to;
        for (const std::size_t row : place_) {
          std::memcpy(block, from + row, 6 * sizeof(double));
          block += 6;
        }
      }
    }
  }

  /// The columns of block j of the panel: with D = L_jj⁻¹ and all later rows R of the front, Y = L_Rj D,
  /// Z_Rj = −Z_RR Y, Z_jj = DᵀD − Yᵀ Z_Rj.
  void compute_column(std::size_t s, int j, double* z) {
    const DenseKernels& kernels = arithmetic_.kernels;
    const int h = l_.height(s), below = h - 6 * (j + 1);
    const auto stride = static_cast<std::size_t>(h);
    // Dᵀ, column-major.
    const double* inverse = l_.inverse.data() + 36 * (std::size_t{l_.first[s]} + static_cast<std::size_t>(j));
    double negative[36];
    for (std::size_t i = 0; i < 36; ++i) negative[i] = -inverse[i];
    double* z_jj = z + 6 * static_cast<std::size_t>(j) * (stride + 1);
    kernels.subtract_abt(6, 6, negative, 6, inverse, 6, z_jj, h, true);
    if (below == 0) return;
    const double* left =
        l_.values.data() + l_.value_start[s] + 6 * static_cast<std::size_t>(j) * (stride + 1) + 6;
    y_.resize(static_cast<std::size_t>(6 * below));
    kernels.subtract_abt(below, 6, left, h, negative, 6, y_.data(), below, true);
    double *z_rj = z_jj + 6, *z_jr = z_jj + 6 * stride;
    kernels.subtract_ab(below, below, z_jr + 6, h, y_.data(), below, z_rj, h, true);
    for (std::size_t i = 0; i < static_cast<std::size_t>(below); ++i) {
      for (std::size_t c = 0; c < 6; ++c) z_jr[i * stride + c] = z_rj[c * stride + i];
    }
    kernels.subtract_ab(6, below, z_jr, h, y_.data(), below, z_jj, h, false);
  }

  /// The same for all columns of the panel at a time.
  void compute_by_blas(std::size_t s, double* z) {
    const int width = l_.columns(s), height = l_.height(s), below = l_.below(s);
    const auto h = static_cast<std::size_t>(height), w = static_cast<std::size_t>(width);
    const auto b = static_cast<std::size_t>(below);
    const double* l = l_.values.data() + l_.value_start[s];
    if (below > 0) {
      y_.resize(b * w);
      for (std::size_t j = 0; j < w; ++j) std::copy_n(l + j * h + w, b, y_.data() + j * b);
      blas::trsm('R', 'N', below, width, l, height, y_.data(), below);
      blas::symm(below, width, -1.0, z + w * h + w, height, y_.data(), below, 0.0, z + w, height);
    }
    for (std::size_t j = 0; j < w; ++j) {
      for (std::size_t i = 0; i < w; ++i) z[j * h + i] = i == j ? 1.0 : 0.0;
    }
    blas::trsm('L', 'N', width, width, l, height, z, height);
    blas::trsm('L', 'T', width, width, l, height, z, height);
    if (below > 0) {
      blas::gemm('T', 'N', width, width, below, -1.0, y_.data(), below, z + w, height, 1.0, z, height);
    }
    for (std::size_t j = 0; j < w; ++j) {
      for (std::size_t i = w; i < h; ++i) z[i * h + j] = z[j * h + i];
    }
  }

  const Panels& l_;
  FrontArithmetic arithmetic_;
  std::vector<double> y_;
  std::vector<std::size_t> place_;
};

}  // namespace

Eigen::MatrixXd selected_inverse(const Panels& l, Rounding rounding,
                                 const std::function<void(std::size_t, const double*)>& visit) {
  std::optional<SingleThreadedBlas> guard;
  if (rounding == Rounding::kFastest) guard.emplace();
  Eigen::MatrixXd out(6, 6 * static_cast<Eigen::Index>(l.block_columns()));
  // Panels are in postorder and are visited backwards: a front is needed until the first of its children.
  const std::vector<std::size_t> first_child = first_children(l);
  Fronts fronts(l, rounding);
  std::vector<Front> stack;
  std::vector<std::vector<double>> spare;
  for (std::size_t s = l.size(); s-- > 0;) {
    std::vector<double> z;
    if (!spare.empty()) {
      z.swap(spare.back());
      spare.pop_back();
    }
    fronts.compute(s, l.parent[s] < 0 ? nullptr : &stack.back(), z);
    if (visit) visit(s, z.data());
    const auto height = static_cast<Eigen::Index>(l.height(s));
    for (int column = 0; column < l.columns(s); column += 6) {
      out.middleCols<6>(6 * static_cast<Eigen::Index>(l.first[s]) + column) =
          Eigen::Map<const Eigen::Matrix<double, 6, 6>, 0, Eigen::OuterStride<>>(
              z.data() + column * (height + 1), Eigen::OuterStride<>(height));
    }
    if (l.parent[s] >= 0 && first_child[static_cast<std::size_t>(l.parent[s])] == s) {
      spare.push_back(std::move(stack.back().z));
      stack.pop_back();
    }
    if (first_child[s] < s) {
      stack.push_back({s, std::move(z)});
    } else {
      spare.push_back(std::move(z));
    }
  }
  return out;
}

}  // namespace loopwise::detail
