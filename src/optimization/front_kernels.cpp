// SPDX-License-Identifier: BSD-3-Clause
#include "front_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 2
#include "front_kernels.inc"

#ifdef LOOPWISE_AVX2_KERNELS
const FrontKernels& front_kernels_avx2();
#endif

const FrontKernels& front_kernels_baseline() {
  return kKernels;
}

const FrontKernels& front_kernels() {
#ifdef LOOPWISE_AVX2_KERNELS
  static const bool wide = __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0;
  if (wide) return front_kernels_avx2();
#endif
  return kKernels;
}

}  // namespace loopwise::detail
