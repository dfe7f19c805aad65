// SPDX-License-Identifier: BSD-3-Clause
#include "dense_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 8
#define LOOPWISE_FUSED
#include "dense_kernels.inc"

const DenseKernels& dense_kernels_avx512();
const DenseKernels& dense_kernels_avx512() {
  return kKernels;
}

}  // namespace loopwise::detail
