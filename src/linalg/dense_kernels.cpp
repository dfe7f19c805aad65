// SPDX-License-Identifier: BSD-3-Clause
#include "dense_kernels.hpp"

namespace loopwise::detail {

#define LOOPWISE_LANES 2
#include "dense_kernels.inc"

#ifdef LOOPWISE_WIDE_KERNELS
const DenseKernels& dense_kernels_avx2();
const DenseKernels& dense_kernels_fma();
const DenseKernels& dense_kernels_avx512();

namespace {

struct Support {
  const bool avx2 = __builtin_cpu_supports("avx2") != 0;
  const bool fma = avx2 && __builtin_cpu_supports("fma") != 0;
  const bool avx512 =
      fma && __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512vl") != 0;
};

const Support& support() {
  static const Support instance;
  return instance;
}

}  // namespace
#endif

const DenseKernels& dense_kernels_baseline() {
  return kKernels;
}

const DenseKernels& dense_kernels([[maybe_unused]] Rounding rounding) {
#ifdef LOOPWISE_WIDE_KERNELS
  if (rounding == Rounding::kFastest && support().avx512) return dense_kernels_avx512();
  if (rounding == Rounding::kFastest && support().fma) return dense_kernels_fma();
  if (support().avx2) return dense_kernels_avx2();
#endif
  return kKernels;
}

AllDenseKernels all_dense_kernels() {
  AllDenseKernels all;
  const auto add = [&](const DenseKernels& kernels) { all.kernels[all.count++] = &kernels; };
  add(kKernels);
#ifdef LOOPWISE_WIDE_KERNELS
  if (support().avx2) add(dense_kernels_avx2());
  if (support().fma) add(dense_kernels_fma());
  if (support().avx512) add(dense_kernels_avx512());
#endif
  return all;
}

}  // namespace loopwise::detail
