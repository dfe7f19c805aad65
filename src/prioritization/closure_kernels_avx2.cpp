// SPDX-License-Identifier: BSD-3-Clause
#include "closure_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 4
#include "closure_kernels.inc"

const ClosureKernels& closure_kernels_avx2();
const ClosureKernels& closure_kernels_avx2() {
  return kKernels;
}

}  // namespace loopwise::detail
