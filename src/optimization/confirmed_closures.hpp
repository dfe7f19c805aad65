// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <optional>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

#include "odometry_forest.hpp"

namespace loopwise::detail {

/// Finds closures that a nearby closure confirms: the ends of both are a few steps of odometry apart, and the
/// short path across the other closure (odometry, closure, odometry) predicts the measurement within the
/// noise. This test does not depend on the uncertainty of odometry over the whole path between the ends. A
/// false closure between random places has no such neighbour; false closures that agree in groups have one.
/// One value per edge.
/// \param wanted closures to test, by edge; all closures may confirm them \param c2 threshold of d² = rᵀS⁻¹r
[[nodiscard]] std::vector<char> confirmed_closures(const PoseGraph& graph, const OdometryForest& forest,
                                                   const std::vector<char>& wanted, double c2);

/// The largest groups of closures that confirm each other: right closures confirm each other all along a
/// second passage, false ones that agree do so in small groups. Each has at least a tenth of the closures of
/// the largest one. If that one has less than a tenth of all, passages are short: then the largest groups
/// that hold half of the closures. \param wanted closures that may belong to a group, by edge; others are not
/// used
[[nodiscard]] std::vector<char> in_large_groups(const PoseGraph& graph, const OdometryForest& forest,
                                                const std::vector<char>& wanted, double c2);

/// The number of closures in the group of each wanted closure, itself included, by edge; 0 for the others. A
/// group is a set of wanted closures that confirm each other, directly or through others.
[[nodiscard]] std::vector<std::size_t> group_sizes(const PoseGraph& graph, const OdometryForest& forest,
                                                   const std::vector<char>& wanted, double c2);

/// Variance of the noise of closures relative to the stated one, from the closures that have another one near
/// them: the lower decile of d² with respect to the nearest one, relative to its expectation. It remains
/// valid if two thirds of the closures are false, as a tenth of the pairs then consists of right ones; groups
/// of false closures that agree with each other show the same noise as true ones. Nothing if few closures
/// have another one near them.
[[nodiscard]] std::optional<double> noise_of_neighbours(const PoseGraph& graph, const OdometryForest& forest);

}  // namespace loopwise::detail
