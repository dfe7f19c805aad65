// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Results of an optimisation as CSV, in the order of the graph's nodes and edges.
#pragma once

#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// A row for every edge: edge, from, to, weight and kind, which is odometry, closure or landmark.
/// \param graph whose edges they are
/// \param weights one per edge, such as GncResult::weights
/// \throws InputError on another number of weights
[[nodiscard]] LOOPWISE_EXPORT std::string weights_csv(const PoseGraph& graph,
                                                      const std::vector<double>& weights);

/// A row for every node: its key and the upper triangle of its covariance by rows, translation before
/// rotation. Numbers read back to the same bits.
/// \param graph whose nodes they are
/// \param covariances one per node, such as Marginals::covariances
/// \throws InputError on another number of covariances
[[nodiscard]] LOOPWISE_EXPORT std::string covariances_csv(const PoseGraph& graph,
                                                          const std::vector<Matrix6d>& covariances);

}  // namespace loopwise
