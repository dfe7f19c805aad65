// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>

#include "linalg/block_matrix.hpp"

namespace loopwise::detail {

/// The Gauss-Newton Hessian of a graph at its poses, with the present weights of its edges. A component
/// without a prior is held at its first node; nodes without factors are held too.
struct GraphHessian {
  static constexpr std::uint32_t kHeld = UINT32_MAX;

  LOOPWISE_EXPORT explicit GraphHessian(const PoseGraph& graph);

  std::vector<std::uint32_t> variable;  ///< By node; kHeld if its pose is held.
  std::vector<std::uint32_t> nodes;     ///< By variable.
  BlockMatrix blocks;                   ///< By variable and pair.
};

}  // namespace loopwise::detail
