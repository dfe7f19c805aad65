// SPDX-License-Identifier: BSD-3-Clause
#include "front_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 4
#include "front_kernels.inc"

const FrontKernels& front_kernels_avx2();
const FrontKernels& front_kernels_avx2() {
  return kKernels;
}

}  // namespace loopwise::detail
