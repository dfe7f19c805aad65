// SPDX-License-Identifier: BSD-3-Clause
#include "closure_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 2
#include "closure_kernels.inc"

#ifdef LOOPWISE_AVX2_KERNELS
const ClosureKernels& closure_kernels_avx2();
#endif

const ClosureKernels& closure_kernels_baseline() {
  return kKernels;
}

const ClosureKernels& closure_kernels() {
#ifdef LOOPWISE_AVX2_KERNELS
  static const bool wide = __builtin_cpu_supports("avx2") != 0;
  if (wide) return closure_kernels_avx2();
#endif
  return kKernels;
}

}  // namespace loopwise::detail
