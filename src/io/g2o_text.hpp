// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/io/g2o.hpp>

namespace loopwise {

/// A g2o file with these priors instead of the graph's own, some of which may be in another file.
[[nodiscard]] std::string g2o_text(const PoseGraph& graph, const std::vector<PriorFactor>& priors);

/// As parse_g2o(), for a file whose program may have been stopped during writing. Leaves out and counts a
/// last line without a line end, because its last number may be cut off, and edges to missing vertices. The
/// file may have no vertex.
[[nodiscard]] G2oFile parse_unfinished_g2o(std::string_view text, const std::string& source);

}  // namespace loopwise
