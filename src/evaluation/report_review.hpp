// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Closures of a run for a person to look at: both scans, aligned in three ways.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/evaluation/report.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// A verified closure of closures.csv. Numbers may be NaN.
struct ReviewedClosure {
  Key from = 0, to = 0;
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();
  double weight = 1.0;
  double overlap = 0.0;
  double time_s = 0.0;
};

/// Input of a review.
struct ReviewedRun {
  const PoseGraph& graph;                            ///< At the last estimate.
  const std::map<Key, Eigen::Isometry3d>& odometry;  ///< Of the nodes with known odometry.
  const std::map<Key, std::uint32_t>& place;         ///< Number of each node that the page shows.
  const Mission& mission;                            ///< With the scans.
};

/// The closures to review first: those that the back end has excluded, then those with the largest
/// displacement by the estimate. Each has the relative pose by odometry, by the registration and by the
/// estimate as 3x4 matrices, row by row, in the frame of `from`; scans are points in the body frame,
/// quantised to 16 bits. Null if there is no closure with nodes and scans.
[[nodiscard]] Json review_json(std::vector<ReviewedClosure> closures, const ReviewedRun& run,
                               const ReportOptions& options);

}  // namespace loopwise
