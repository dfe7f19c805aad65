// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Dense kernels for matrices whose rows and columns come in sixes. Most of those of pose graphs are too
/// small for calls of BLAS to pay off; products of large ones are taken in pieces (kStripe). Matrices are
/// column-major unless stated otherwise. The first call chooses the widest instructions of the processor.
#pragma once

#include <cstddef>
#include <cstdint>

#include <loopwise/core/export.hpp>

namespace loopwise::detail {

/// How sums of products are rounded.
enum class Rounding {
  kFastest,   ///< The widest registers, with fused multiply-add where the processor has it. Results on
              ///< different processors agree within rounding.
  kPortable,  ///< The same operations in the same order on every processor of the family: the same bits.
};

/// L as the kernels read it: the arrays of Panels.
struct PanelView {
  std::size_t size = 0;
  const std::uint32_t* first = nullptr;
  const std::size_t* row_start = nullptr;
  const std::uint32_t* rows = nullptr;
  const std::size_t* value_start = nullptr;
  const double* values = nullptr;
  const double* inverse = nullptr;
};

/// A panel on the path of a sparse right-hand side, and its first block column that is not zero.
struct PathStep {
  std::uint32_t panel = 0;
  std::uint32_t column = 0;  ///< Counted from the panel's first one.
};

/// The inner dimension of one call of a product, and its rows: a second-level cache of 1 MB holds so many
/// columns and rows. Multiples of 6.
inline constexpr int kStripe = 96, kStripeRows = 768;

struct DenseKernels {
  /// C −= A·Bᵀ, or C = −A·Bᵀ if `overwrite`; C is m×6, A m×k, B 6×k, m even,
  /// k ≥ 1.
  void (*subtract_abt)(int m, int k, const double* a, int lda, const double* b, int ldb, double* c, int ldc,
                       bool overwrite);
  /// The same with B instead of Bᵀ; B is k×6.
  void (*subtract_ab)(int m, int k, const double* a, int lda, const double* b, int ldb, double* c, int ldc,
                      bool overwrite);
  /// Factorises the m×6 column block at `a`: its upper 6×6 becomes L (lower triangle), the rows below
  /// A·L⁻ᵀ. \returns false if a pivot is not positive.
  bool (*eliminate)(int m, double* a, int lda);
  /// y −= A·x, A being m×6.
  void (*apply)(int m, const double* a, int lda, const double* x, double* y);
  /// x −= Aᵀ·y, A being m×6.
  void (*apply_transposed)(int m, const double* a, int lda, const double* y, double* x);

  // Several right-hand sides: row-major 6×width blocks, one for each block column of L in elimination order.
  // Width is 6, 12, 16 or 24. Each column of X has the same bits for any width.

  /// C −= A·B; A is 6×6, B and C are 6×width and row-major.
  void (*subtract_wide)(const double* a, const double* b, int width, double* c);
  /// X = L⁻¹X. X may be non-zero only in the columns of `path`: panels ascend, and the rows below each panel
  /// are in panels of the path. Null: all panels.
  void (*forward)(const PanelView& l, const PathStep* path, std::size_t path_size, int width, double* x);
  /// X = L⁻ᵀX.
  void (*backward)(const PanelView& l, int width, double* x);
  /// XᵀX over the first `counted` rows of each of `blocks` blocks, width×width; width is 6 or 12.
  void (*gram)(const double* x, std::size_t blocks, int counted, int width, double* out);
};

[[nodiscard]] LOOPWISE_EXPORT const DenseKernels& dense_kernels(Rounding rounding);
/// The kernels that run on any processor of the family. Their bits are those of kPortable.
[[nodiscard]] LOOPWISE_EXPORT const DenseKernels& dense_kernels_baseline();
/// All kernels that this processor can run, for tests.
struct AllDenseKernels {
  const DenseKernels* kernels[4] = {};
  int count = 0;
  [[nodiscard]] const DenseKernels* const* begin() const { return kernels; }
  [[nodiscard]] const DenseKernels* const* end() const { return kernels + count; }
};
[[nodiscard]] LOOPWISE_EXPORT AllDenseKernels all_dense_kernels();

}  // namespace loopwise::detail
