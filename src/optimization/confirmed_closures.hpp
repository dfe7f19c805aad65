// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "odometry_forest.hpp"

namespace loopwise::detail {

/// Closures that a closure near them confirms: one whose ends are a few steps of odometry from theirs, with a
/// measurement that the short way over it (odometry, the other closure, odometry) predicts within the noise.
/// A false closure between random places has none, however uncertain odometry is over the whole way between
/// its ends; false closures that agree in groups have. By edge.
/// \param wanted closures to look at, by edge; all may confirm them \param c2 threshold of d² = rᵀS⁻¹r
[[nodiscard]] std::vector<char> confirmed_closures(const PoseGraph& graph, const OdometryForest& forest,
                                                   const std::vector<char>& wanted, double c2);

}  // namespace loopwise::detail
