// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// When two closures agree.
struct PcmOptions {
  /// Two closures agree if the error of their loop is below this quantile of chi-squared with 6 degrees of
  /// freedom.
  double inlier_probability = 0.99;
  /// Maximum number of closures that are compared pair by pair.
  std::size_t max_group = 5000;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("inlier_probability", self.inlier_probability, Bounds{0.0, 0.999999, true});
    field("max_group", self.max_group, at_least(2.0));
  }
};

/// The selection of closures.
struct PcmResult {
  std::vector<bool> kept;    ///< One per edge, in graph order. Known inliers are always kept.
  std::size_t inliers = 0;   ///< Number of kept closures.
  std::size_t outliers = 0;  ///< The other closures.
};

/// Pairwise consistency maximisation (Mangelson et al., ICRA 2018): keeps, for each pair of odometry chains
/// (usually: robots), a large set of closures in which every two agree with each other and the odometry
/// between their ends, found by a greedy clique search. Odometry's covariance is propagated along the chain
/// to first order. It is a filter before optimize_gnc(), for small groups of false closures that agree.
/// Quadratic in the closures. \throws OptionError; InputError if a group is larger than max_group or a
/// closure's information is singular.
[[nodiscard]] LOOPWISE_EXPORT PcmResult pairwise_consistent(const PoseGraph& graph,
                                                            const PcmOptions& options = {});

}  // namespace loopwise
