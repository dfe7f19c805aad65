// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/registration/consensus.hpp>

namespace loopwise {

/// consensus() without its checks. \param count maximum number of poses
[[nodiscard]] Consensus find_consensus(const std::vector<Match>& matches, double tolerance_m,
                                       std::size_t count, const PoseFilter& allowed = {});

/// Rigid transform T with the least Σ |T·source − target|² over the chosen matches (Umeyama 1991).
[[nodiscard]] Eigen::Isometry3d fit_rigid(const std::vector<Match>& matches,
                                          const std::vector<std::size_t>& chosen);

}  // namespace loopwise
