// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Dense kernels for fronts whose rows and columns come in sixes: they are too small for calls of BLAS to pay
/// off. Matrices are column-major. The first call chooses the widest instructions of the processor.
#pragma once

namespace loopwise::detail {

struct FrontKernels {
  /// C −= A·Bᵀ, or C = −A·Bᵀ if `overwrite`; C is m×6, A m×k, B 6×k, m even.
  void (*multiply)(int m, int k, const double* a, int lda, const double* b, int ldb, double* c, int ldc,
                   bool overwrite);
  /// Factorises the m×6 column block at `a`: its upper 6×6 becomes L (lower triangle), the rows below
  /// A·L⁻ᵀ. \returns false if a pivot is not positive.
  bool (*eliminate)(int m, double* a, int lda);
  /// y −= A·x, A being m×6.
  void (*apply)(int m, const double* a, int lda, const double* x, double* y);
  /// x −= Aᵀ·y, A being m×6.
  void (*apply_transposed)(int m, const double* a, int lda, const double* y, double* x);
};

[[nodiscard]] const FrontKernels& front_kernels();
/// The kernels that run on any processor of the family.
[[nodiscard]] const FrontKernels& front_kernels_baseline();

}  // namespace loopwise::detail
