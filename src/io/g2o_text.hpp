// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/io/g2o.hpp>

namespace loopwise {

/// A g2o file with these priors in the place of the graph's own, which may have gone to another file.
[[nodiscard]] std::string g2o_text(const PoseGraph& graph, const std::vector<PriorFactor>& priors);

/// As parse_g2o(), of a file whose program may have been stopped while it wrote: a last line without line
/// end, of which a part of the last number may be missing, and edges to missing vertices are left out and
/// counted, and there may be no vertex at all.
[[nodiscard]] G2oFile parse_unfinished_g2o(std::string_view text, const std::string& source);

}  // namespace loopwise
