// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Statistics of a mission before any computation: drift of the odometry, number of candidates by proximity,
/// and the share that saw the same place.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Error of one robot's odometry with its first pose aligned to the truth.
struct RobotDrift {
  std::string robot;         ///< Its name.
  double length_m = 0.0;     ///< True path over the nodes.
  double largest_m = 0.0;    ///< Largest error of a position.
  double largest_rad = 0.0;  ///< Largest error of an attitude.
  double end_m = 0.0;        ///< Error of the last position.
};

/// One per robot that has at least two nodes with ground truth, in the order of the robots.
[[nodiscard]] LOOPWISE_EXPORT std::vector<RobotDrift> odometry_drift(const Mission& mission);

/// Selection of candidates, and the criterion for scans of the same place.
struct CandidateStatisticsOptions {
  /// Nodes within this distance by the estimate are candidates, m.
  double radius_m = 30.0;
  /// Two nodes of one robot are candidates only if their indices differ by at least this much.
  int skip_recent = 10;
  /// Number of candidates to measure, drawn at random.
  int pairs = 1000;
  /// A point is shared if the other scan has a point within this distance, m.
  double near_m = 1.0;
  /// Minimum share of shared points of a true overlap.
  double min_overlap = 0.5;
  /// Number of threads. 0: one per processor.
  int threads = 0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("radius_m", self.radius_m, above(0.0));
    field("skip_recent", self.skip_recent, at_least(1.0));
    field("pairs", self.pairs, at_least(0.0));
    field("near_m", self.near_m, above(0.0));
    field("min_overlap", self.min_overlap, between(0.0, 1.0));
    field("threads", self.threads, between(0, 1024));
  }
};

/// Number of candidates by proximity, and their quality by the truth.
struct CandidateStatistics {
  std::size_t candidates = 0;  ///< All within the radius, by the odometry's poses.
  std::size_t looked_at = 0;   ///< Examined candidates, with two scans and ground truth.
  double mean_overlap =
      0.0;  ///< Share of the newer scan's points that the older scan has too, by the true poses.
  double overlapping = 0.0;    ///< Share of the examined pairs with true overlap.
  double within_radius = 0.0;  ///< Share of the examined pairs within the radius in truth too.
};

/// Candidates by proximity as LAMP's base station generates them. The draw depends on the mission alone.
/// \throws OptionError; exceptions of reading the scans.
[[nodiscard]] LOOPWISE_EXPORT CandidateStatistics
candidate_statistics(const Mission& mission, const CandidateStatisticsOptions& options = {});

}  // namespace loopwise
