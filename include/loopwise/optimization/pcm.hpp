// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

struct PcmOptions {
  double inlier_probability = 0.99;
  bool per_robot_pair = true;
  std::size_t max_group = 5000;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("inlier_probability", self.inlier_probability, Bounds{0.0, 1.0 - 1e-12, true},
          "Two closures agree if their loop's error lies below this quantile of chi-squared with 6 degrees "
          "of freedom.");
    field("per_robot_pair", self.per_robot_pair, any_value(),
          "Search one set for each pair of odometry chains; otherwise one set in all.");
    field("max_group", self.max_group, at_least(2), "Bound on the closures that are compared pair by pair.");
  }
};

struct PcmResult {
  std::vector<bool> kept;  ///< One per edge, in graph order. Known inliers are always kept.
  std::size_t inliers = 0;
  std::size_t outliers = 0;
};

/// Pairwise consistency maximisation (Mangelson et al., ICRA 2018): keeps, for each pair of odometry chains,
/// the largest set of closures that the greedy clique search finds in which every two agree with the odometry
/// between their ends. Odometry's covariance is carried along the chain. \throws OptionError; InputError if a
/// group is larger than max_group or odometry's information is singular.
[[nodiscard]] PcmResult pairwise_consistent(const PoseGraph& graph, const PcmOptions& options = {});

}  // namespace loopwise
