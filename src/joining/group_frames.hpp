// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Frames of components that are joined by ties, from robust optimisation over all their paths. Private to
/// joining.
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/stop_token.hpp>
#include <loopwise/joining/join.hpp>

#include "component_paths.hpp"

namespace loopwise::joining {

/// Result of the optimisation of one group.
struct GroupFrames {
  std::vector<double> kept;               ///< For each tie, the share of its closures that were kept.
  std::vector<Eigen::Isometry3d> frames;  ///< One per member, in the frame of the first.
  std::vector<Matrix6d> covariances;      ///< Of each member's first key frame, see ComponentFrame.
};

/// Optimises the members' paths with the closures of the ties. The options state the uncertainty of odometry.
/// \param members numbers of the components; the first one stays fixed
/// \param ties connect all members
[[nodiscard]] GroupFrames optimize_group(const ComponentPaths& paths, const std::vector<std::size_t>& members,
                                         const std::vector<const Tie*>& ties, const StopToken& stop);

}  // namespace loopwise::joining
