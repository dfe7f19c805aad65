// SPDX-License-Identifier: BSD-3-Clause
#include "dense_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 4
#define LOOPWISE_FUSED
#include "dense_kernels.inc"

const DenseKernels& dense_kernels_fma();
const DenseKernels& dense_kernels_fma() {
  return kKernels;
}

}  // namespace loopwise::detail
