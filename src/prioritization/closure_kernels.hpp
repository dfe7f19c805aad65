// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Kernels of a block-sparse Cholesky factor and of substitution with it, for many columns at a time. The
/// first call chooses the widest registers of the processor. All variants round equally, so the results are
/// the same to the bit.
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
  /// C −= A·B; A is 6×6 and column-major, B and C are 6×width and row-major.
  void (*subtract)(const double* a, const double* b, int width, double* c);
  /// Subtracts the update by a finished column from the next column. With L_kj the block at `first`, every
  /// block L_ij from `first` on changes the block at place[i]: −= L_ij·L_kjᵀ.
  void (*update)(const std::uint32_t* rows, const std::uint32_t* place, std::size_t first, std::size_t last,
                 double* values);
  /// X = L⁻¹X. X may be non-zero only in the columns of `path`, which is ascending and contains the rows
  /// below each of its columns; null: all columns.
  void (*forward)(const BlockColumns& l, const std::uint32_t* path, std::size_t path_size, int width,
                  double* x);
  /// X = L⁻ᵀX.
  void (*backward)(const BlockColumns& l, int width, double* x);
};

[[nodiscard]] const ClosureKernels& closure_kernels();
/// The kernels that run on any processor of the family.
[[nodiscard]] const ClosureKernels& closure_kernels_baseline();

}  // namespace loopwise::detail
