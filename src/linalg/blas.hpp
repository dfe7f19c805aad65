// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// BLAS routines for dense column-major panels.
#pragma once

#include <cstddef>

extern "C" {
void dgemm_(const char* transa, const char* transb, const int* m, const int* n, const int* k,
            const double* alpha, const double* a, const int* lda, const double* b, const int* ldb,
            const double* beta, double* c, const int* ldc);
void dsymm_(const char* side, const char* uplo, const int* m, const int* n, const double* alpha,
            const double* a, const int* lda, const double* b, const int* ldb, const double* beta, double* c,
            const int* ldc);
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* beta, double* c, const int* ldc);
void dtrsm_(const char* side, const char* uplo, const char* transa, const char* diag, const int* m,
            const int* n, const double* alpha, const double* a, const int* lda, double* b, const int* ldb);
}

namespace loopwise::detail::blas {

/// C = alpha·op(A)·op(B) + beta·C, C being m×n and k the inner dimension.
inline void gemm(char transa, char transb, int m, int n, int k, double alpha, const double* a, int lda,
                 const double* b, int ldb, double beta, double* c, int ldc) {
  if (m > 0 && n > 0) dgemm_(&transa, &transb, &m, &n, &k, &alpha, a, &lda, b, &ldb, &beta, c, &ldc);
}

/// C = alpha·A·B + beta·C with A symmetric m×m, its lower triangle stored; C is m×n.
inline void symm(int m, int n, double alpha, const double* a, int lda, const double* b, int ldb, double beta,
                 double* c, int ldc) {
  if (m > 0 && n > 0) dsymm_("L", "L", &m, &n, &alpha, a, &lda, b, &ldb, &beta, c, &ldc);
}

/// Lower triangle of C = alpha·A·Aᵀ + beta·C, A being n×k.
inline void syrk(int n, int k, double alpha, const double* a, int lda, double beta, double* c, int ldc) {
  if (n > 0) dsyrk_("L", "N", &n, &k, &alpha, a, &lda, &beta, c, &ldc);
}

/// B = op(L)⁻¹·B (side 'L') or B·op(L)⁻¹ (side 'R'), L lower triangular, B m×n.
inline void trsm(char side, char trans, int m, int n, const double* l, int ldl, double* b, int ldb) {
  const double one = 1.0;
  if (m > 0 && n > 0) dtrsm_(&side, "L", &trans, "N", &m, &n, &one, l, &ldl, b, &ldb);
}

}  // namespace loopwise::detail::blas
