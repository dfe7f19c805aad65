// SPDX-License-Identifier: BSD-3-Clause
#pragma once

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

/// The trees of odometry, joined where a robot's odometry is broken: by closures between nodes whose keys are
/// hardly apart, first those that another closure between the same two trees confirms. Those that others
/// between these trees do not confirm are left out. Trees that priors join already are not joined again.
/// Without this, no innovation across the break is known. Files in which some steps are swapped have hundreds
/// of such breaks. The closures that join trees are not trusted otherwise. \param c2 threshold of d² = rᵀS⁻¹r
[[nodiscard]] OdometryForest joined_forest(const PoseGraph& graph, double c2);

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

/// d² of every closure with respect to the nearest other one, unless it has none near it or is a copy of it.
/// Empty if few closures have another one near them.
[[nodiscard]] std::vector<double> innovations_of_neighbours(const PoseGraph& graph,
                                                            const OdometryForest& forest);

/// Variance of the noise of closures relative to the stated one: the lower decile of their d² with respect to
/// the nearest other one, relative to its expectation. It remains valid if two thirds of the closures are
/// false, as a tenth of the pairs then consists of right ones; groups of false closures that agree with each
/// other show the same noise as true ones. \param d2 of innovations_of_neighbours(), not empty
[[nodiscard]] double noise_of_neighbours(std::vector<double> d2, int degrees_of_freedom);

}  // namespace loopwise::detail
