// SPDX-License-Identifier: BSD-3-Clause
#include "dense_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 2
#include "dense_kernels.inc"

#ifdef LOOPWISE_AVX2_KERNELS
const DenseKernels& dense_kernels_avx2();
const DenseKernels& dense_kernels_fma();
#endif

const DenseKernels& dense_kernels_baseline() {
  return kKernels;
}

const DenseKernels& dense_kernels([[maybe_unused]] Rounding rounding) {
#ifdef LOOPWISE_AVX2_KERNELS
  static const bool wide = __builtin_cpu_supports("avx2") != 0;
  static const bool fused = wide && __builtin_cpu_supports("fma") != 0;
  if (fused && rounding == Rounding::kFastest) return dense_kernels_fma();
  if (wide) return dense_kernels_avx2();
#endif
  return kKernels;
}

}  // namespace loopwise::detail
