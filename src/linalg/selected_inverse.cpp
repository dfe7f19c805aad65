// SPDX-License-Identifier: BSD-3-Clause
#include "selected_inverse.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

#include "front.hpp"

namespace loopwise::detail {
namespace {

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
  Fronts(const Panels& l, Rounding rounding) : l_(l), kernels_(dense_kernels(rounding)) {}

  /// Computes Z over all rows and columns of a panel's front; `parent` is the front above, or null for a
  /// root. With the panel's columns W, the rows R below them and Y = L_RW L_WW⁻¹: Z_RW = −Z_RR Y,
  /// Z_WW = L_WW⁻ᵀ L_WW⁻¹ − Yᵀ Z_RW.
  void compute(std::size_t s, const Front* parent, std::vector<double>& z) {
    const auto h = static_cast<std::size_t>(l_.height(s)), w = static_cast<std::size_t>(l_.columns(s));
    z.resize(h * h);
    if (parent != nullptr) take_from_parent(s, *parent, z.data());
    for (int j = l_.columns(s) - 6; j >= 0; j -= 6) invert_column(s, j, z.data());
    if (h == w) return;
    divide(s);
    multiply_by_parent(s, z.data());
    add_square(s, z.data());
    for (std::size_t j = 0; j < w; ++j) {
      for (std::size_t i = j + 1; i < h; ++i) z[i * h + j] = z[j * h + i];
    }
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

  /// Columns j … j + 5 of L_WW⁻ᵀ L_WW⁻¹ and their transpose: with D = L_jj⁻¹, all later columns K of the
  /// panel and Y = L_Kj D, Z_Kj = −Z_KK Y, Z_jj = DᵀD − Yᵀ Z_Kj.
  void invert_column(std::size_t s, int j, double* z) {
    const int h = l_.height(s), later = l_.columns(s) - j - 6;
    const auto stride = static_cast<std::size_t>(h);
    double negative[36];
    const double* inverse = inverse_of(s, j, negative);
    double* z_jj = z + static_cast<std::size_t>(j) * (stride + 1);
    kernels_.subtract_abt(6, 6, negative, 6, inverse, 6, z_jj, h, true);
    if (later == 0) return;
    y_.resize(static_cast<std::size_t>(6 * later));
    kernels_.subtract_abt(later, 6, panel(s) + static_cast<std::size_t>(j) * (stride + 1) + 6, h, negative, 6,
                          y_.data(), later, true);
    double *z_kj = z_jj + 6, *z_jk = z_jj + 6 * stride;
    subtract_in_stripes(later, later, z_jk + 6, h, y_.data(), later, z_kj, h, true);
    for (std::size_t i = 0; i < static_cast<std::size_t>(later); ++i) {
      for (std::size_t c = 0; c < 6; ++c) z_jk[i * stride + c] = z_kj[c * stride + i];
    }
    subtract_in_stripes(6, later, z_jk, h, y_.data(), later, z_jj, h, false);
  }

  /// Y = L_RW L_WW⁻¹, from the last column to the first.
  void divide(std::size_t s) {
    const int h = l_.height(s), w = l_.columns(s), m = l_.below(s);
    const auto rows = static_cast<std::size_t>(m), stride = static_cast<std::size_t>(h);
    y_.resize(rows * static_cast<std::size_t>(w));
    column_.resize(6 * rows);
    for (int j = w - 6; j >= 0; j -= 6) {
      const double* l = panel(s) + static_cast<std::size_t>(j) * stride;
      const int later = w - j - 6;
      const double* left = l + w;
      double* y = y_.data() + static_cast<std::size_t>(j) * rows;
      if (later > 0) {
        for (std::size_t c = 0; c < 6; ++c) std::copy_n(l + c * stride + w, m, column_.data() + c * rows);
        subtract_in_stripes(m, later, y + 6 * rows, m, l + j + 6, h, column_.data(), m, false);
        left = column_.data();
      }
      double negative[36];
      static_cast<void>(inverse_of(s, j, negative));
      kernels_.subtract_abt(m, 6, left, later > 0 ? m : h, negative, 6, y, m, true);
    }
  }

  /// Z_RW = −Z_RR Y. A piece of Z_RR stays in the cache for all columns.
  void multiply_by_parent(std::size_t s, double* z) {
    const int h = l_.height(s), w = l_.columns(s), m = l_.below(s);
    const double* z_rr = z + static_cast<std::size_t>(w) * static_cast<std::size_t>(h + 1);
    for (int p = 0; p < m; p += kStripe) {
      for (int i = 0; i < m; i += kStripeRows) {
        for (int j = 0; j < w; j += 6) {
          kernels_.subtract_ab(std::min(kStripeRows, m - i), std::min(kStripe, m - p),
                               z_rr + static_cast<std::ptrdiff_t>(p) * h + i, h,
                               y_.data() + static_cast<std::ptrdiff_t>(j) * m + p, m,
                               z + static_cast<std::ptrdiff_t>(j) * h + w + i, h, p == 0);
        }
      }
    }
  }

  /// Subtracts Yᵀ Z_RW from the lower triangle of Z_WW.
  void add_square(std::size_t s, double* z) {
    const int h = l_.height(s), w = l_.columns(s), m = l_.below(s);
    transposed_.resize(y_.size());
    for (int j = 0; j < w; ++j) {
      const double* from = y_.data() + static_cast<std::ptrdiff_t>(j) * m;
      double* to = transposed_.data() + j;
      for (int i = 0; i < m; ++i, to += w) *to = from[i];
    }
    for (int p = 0; p < m; p += kStripe) {
      for (int j = 0; j < w; j += 6) {
        double* z_j = z + static_cast<std::ptrdiff_t>(j) * h;
        kernels_.subtract_ab(w - j, std::min(kStripe, m - p),
                             transposed_.data() + static_cast<std::ptrdiff_t>(p) * w + j, w, z_j + w + p, h,
                             z_j + j, h, false);
      }
    }
  }

  /// C −= A·B, or C = −A·B if `overwrite`; C is m×6, B k×6.
  void subtract_in_stripes(int m, int k, const double* a, int lda, const double* b, int ldb, double* c,
                           int ldc, bool overwrite) const {
    for (int p = 0; p < k; p += kStripe, a += static_cast<std::ptrdiff_t>(kStripe) * lda) {
      kernels_.subtract_ab(m, std::min(kStripe, k - p), a, lda, b + p, ldb, c, ldc, overwrite && p == 0);
    }
  }

  [[nodiscard]] const double* panel(std::size_t s) const { return l_.values.data() + l_.value_start[s]; }

  /// \returns Dᵀ of the panel's columns j … j + 5, column-major
  /// \param negative set to −Dᵀ
  const double* inverse_of(std::size_t s, int j, double* negative) const {
    const double* inverse =
        l_.inverse.data() + 36 * (std::size_t{l_.first[s]} + static_cast<std::size_t>(j / 6));
    for (int i = 0; i < 36; ++i) negative[i] = -inverse[i];
    return inverse;
  }

  const Panels& l_;
  const DenseKernels& kernels_;
  std::vector<double> y_, column_, transposed_;
  std::vector<std::size_t> place_;
};

}  // namespace

Eigen::MatrixXd selected_inverse(const Panels& l, Rounding rounding,
                                 const std::function<void(std::size_t, const double*)>& visit) {
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
