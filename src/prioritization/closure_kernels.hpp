// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The work of a block-sparse Cholesky factor and of substitution with it, many columns at a time. The widest
/// registers of the processor are chosen when first asked for; they round as the others do, so that results
/// are the same bits.
#pragma once

#include <cstddef>
#include <cstdint>

namespace loopwise::detail {

/// L by block columns of 6×6 blocks, column-major: the diagonal block first, then rows ascending.
struct BlockColumns {
  std::size_t count = 0;
  const std::size_t* start = nullptr;  ///< Of each column in `rows`; count + 1 of them.
  const std::uint32_t* rows = nullptr;
  const double* values = nullptr;   ///< 36 a block.
  const double* inverse = nullptr;  ///< Of the diagonal blocks, 36 a column.
};

/// Right-hand sides are row-major 6×width blocks, one for each block column; width is 6, 12, 16 or 24.
struct ClosureKernels {
  /// C −= A·B, A 6×6 by columns, B and C 6×width by rows.
  void (*subtract)(const double* a, const double* b, int width, double* c);
  /// Takes a finished column's share from the column that is next: for each of its blocks L_ij from `first`
  /// on, the block at place[i] −= L_ij·L_kjᵀ, L_kj the first of them.
  void (*update)(const std::uint32_t* rows, const std::uint32_t* place, std::size_t first, std::size_t last,
                 double* values);
  /// X = L⁻¹X. X is zero but in the columns of `path`, ascending, which holds with each the rows below it;
  /// null: all.
  void (*forward)(const BlockColumns& l, const std::uint32_t* path, std::size_t path_size, int width,
                  double* x);
  /// X = L⁻ᵀX.
  void (*backward)(const BlockColumns& l, int width, double* x);
};

[[nodiscard]] const ClosureKernels& closure_kernels();
/// Those that run on any processor of the family.
[[nodiscard]] const ClosureKernels& closure_kernels_baseline();

}  // namespace loopwise::detail
