// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/core/random.hpp>

namespace loopwise::detail {

/// Fills 6×width blocks, one per node, with random signs times `scale`: the first `rows` rows of each block.
/// The other rows become 0.
inline void fill_probes(std::vector<double>& x, std::size_t nodes, std::size_t width, std::size_t rows,
                        double scale, Rng rng) {
  x.assign(nodes * 6 * width, 0.0);
  for (std::size_t node = 0; node < nodes; ++node) {
    double* block = x.data() + node * 6 * width;
    std::uint64_t bits = 0;
    for (std::size_t i = 0; i < rows * width; ++i) {
      if (i % 64 == 0) bits = rng();
      block[i] = (bits & 1U) != 0 ? scale : -scale;
      bits >>= 1U;
    }
  }
}

}  // namespace loopwise::detail
