// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// One front of a multifrontal factorisation: w columns with the same rows, as a dense panel `l` of w + m
/// rows, and the m×m update matrix `u` for the parent front. All counts of scalars are multiples of six.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "dense_kernels.hpp"

namespace loopwise::detail {

/// The lower triangle, in whole blocks, of the first n columns of C −= A·Aᵀ; C has m rows, A is m×k.
inline void subtract_lower(const DenseKernels& kernel, int m, int n, int k, const double* a, int lda,
                           double* c, int ldc, bool overwrite) {
  for (int begin = 0; begin < m; begin += kStripeRows) {
    const int end = std::min(m, begin + kStripeRows);
    for (int j = 0; j < std::min(n, end); j += 6) {
      const int first = std::max(begin, j);
      kernel.subtract_abt(end - first, k, a + first, lda, a + j, lda,
                          c + static_cast<std::ptrdiff_t>(j) * ldc + first, ldc, overwrite);
    }
  }
}

/// Cholesky factor of the first w columns of a front, which has h rows. \returns the number of eliminated
/// columns: w unless a pivot is not positive.
inline int eliminate_columns(const DenseKernels& kernel, int w, int h, double* l) {
  const auto column = [&](int j) { return l + static_cast<std::ptrdiff_t>(j) * h; };
  for (int stripe = 0; stripe < w; stripe += kStripe) {
    const int end = std::min(w, stripe + kStripe);
    for (int p = 0; p < stripe; p += kStripe) {
      subtract_lower(kernel, h - stripe, end - stripe, kStripe, column(p) + stripe, h,
                     column(stripe) + stripe, h, false);
    }
    for (int j = stripe; j < end; j += 6) {
      const double* left = column(stripe) + j;
      if (j > stripe) kernel.subtract_abt(h - j, j - stripe, left, h, left, h, column(j) + j, h, false);
      if (!kernel.eliminate(h - j, column(j) + j, h)) return j;
    }
  }
  return w;
}

/// U −= R·Rᵀ, or U = −R·Rᵀ if `overwrite`, in the lower triangle; R is m×w.
inline void subtract_product(const DenseKernels& kernel, int m, int w, const double* r, int ldr, double* u,
                             bool overwrite) {
  for (int p = 0; p < w; p += kStripe, r += static_cast<std::ptrdiff_t>(kStripe) * ldr) {
    subtract_lower(kernel, m, m, std::min(kStripe, w - p), r, ldr, u, m, overwrite && p == 0);
  }
}

/// Adds a child's update matrix to the front of its parent.
/// \param relative the child's `count` block rows as block rows of the parent, ascending
/// \param columns block columns of the parent's panel
/// \param m the parent's scalar rows below its panel
inline void add_update(const std::uint32_t* relative, std::size_t count, const double* update,
                       std::uint32_t columns, std::size_t m, double* l, double* u) {
  const std::size_t h = 6 * std::size_t{columns} + m, ld = 6 * count;
  for (std::size_t j = 0; j < count; ++j) {
    // The front is split: the panel's columns are in l, all others in u, which has no rows for the panel.
    const bool in_panel = relative[j] < columns;
    const std::uint32_t skipped = in_panel ? 0 : columns;
    const std::size_t stride = in_panel ? h : m;
    double* column = (in_panel ? l : u) + 6 * std::size_t{relative[j] - skipped} * stride;
    // Adds consecutive rows together.
    for (std::size_t i = j; i < count;) {
      std::size_t end = i + 1;
      while (end < count && relative[end] == relative[end - 1] + 1) ++end;
      const double* from = update + 6 * j * ld + 6 * i;
      double* to = column + 6 * std::size_t{relative[i] - skipped};
      const std::size_t length = 6 * (end - i);
      for (int c = 0; c < 6; ++c, from += ld, to += stride) {
        for (std::size_t r = 0; r < length; ++r) to[r] += from[r];
      }
      i = end;
    }
  }
}

/// The part of one front in x := L⁻¹x.
/// \param rows block rows of the m rows below, \param top the part of x for the front's columns
inline void solve_front_lower(const DenseKernels& kernel, int w, int m, const double* l,
                              const std::uint32_t* rows, double* top, double* x,
                              std::vector<double>& gathered) {
  const int h = w + m;
  gathered.assign(static_cast<std::size_t>(m), 0.0);
  for (int j = 0; j < w; j += 6) {
    const double* block = l + static_cast<std::ptrdiff_t>(j) * h + j;
    double* y = top + j;
    for (int c = 0; c < 6; ++c) {
      y[c] /= block[c * (h + 1)];
      for (int r = c + 1; r < 6; ++r) y[r] -= block[c * h + r] * y[c];
    }
    kernel.apply(w - j - 6, block + 6, h, y, y + 6);
    kernel.apply(m, l + static_cast<std::ptrdiff_t>(j) * h + w, h, y, gathered.data());
  }
  for (int i = 0; i < m; i += 6, ++rows) {
    for (int r = 0; r < 6; ++r) {
      x[6 * static_cast<std::size_t>(*rows) + static_cast<std::size_t>(r)] +=
          gathered[static_cast<std::size_t>(i + r)];
    }
  }
}

/// The part of one front in x := L⁻ᵀx; parameters as of solve_front_lower().
inline void solve_front_upper(const DenseKernels& kernel, int w, int m, const double* l,
                              const std::uint32_t* rows, double* top, const double* x,
                              std::vector<double>& gathered) {
  const int h = w + m;
  gathered.resize(static_cast<std::size_t>(m));
  for (int i = 0; i < m; i += 6, ++rows) {
    std::copy_n(x + 6 * static_cast<std::size_t>(*rows), 6, gathered.begin() + i);
  }
  for (int j = w - 6; j >= 0; j -= 6) {
    const double* block = l + static_cast<std::ptrdiff_t>(j) * h + j;
    double* y = top + j;
    kernel.apply_transposed(m, l + static_cast<std::ptrdiff_t>(j) * h + w, h, gathered.data(), y);
    kernel.apply_transposed(w - j - 6, block + 6, h, y + 6, y);
    for (int c = 5; c >= 0; --c) {
      for (int r = c + 1; r < 6; ++r) y[c] -= block[c * h + r] * y[r];
      y[c] /= block[c * (h + 1)];
    }
  }
}

}  // namespace loopwise::detail
