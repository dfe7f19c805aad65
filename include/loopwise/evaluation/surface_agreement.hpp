// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Consistency of a map without a truth: the agreement of surfaces in scans of one place from different
/// times.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/evaluation/closure_statistics.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Criteria for revisits, and for points on a surface.
struct SurfaceAgreementOptions {
  /// Two nodes are a revisit if their distance is at most this, m, by the poses that choose revisits.
  double reach_m = 3.0;
  /// The distance of a revisit may exceed reach_m by this share of the path between its nodes.
  double drift = 0.0;
  /// Maximum distance of a revisit in any case, m.
  double reach_most_m = 20.0;
  /// Minimum length of the path between the nodes of a revisit, m. For nodes of two robots, both paths from
  /// the starts must be this long.
  double apart_m = 20.0;
  /// A point lies on a surface if the other scan has a surface within this distance, m.
  double near_m = 0.12;
  /// Number of revisits to measure, drawn evenly from all.
  std::int64_t pairs = 400;
  /// Number of points of each scan to measure, drawn evenly.
  std::int64_t points = 500;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("reach_m", self.reach_m, above(0.0));
    field("drift", self.drift, at_least(0.0));
    field("reach_most_m", self.reach_most_m, above(0.0));
    field("apart_m", self.apart_m, at_least(0.0));
    field("near_m", self.near_m, above(0.0));
    field("pairs", self.pairs, at_least(1));
    field("points", self.points, at_least(1));
  }
};

/// Pairs of nodes that saw one place at different times.
using Revisits = std::vector<std::pair<Key, Key>>;

/// Revisits by these poses. Compare maps on the same revisits: choose them once, for example by the
/// odometry's poses. \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT Revisits find_revisits(const Mission& mission, const PosesByKey& poses,
                                                     const SurfaceAgreementOptions& options = {});

/// Revisits by these poses that are not revisits by `former`: places that only `poses` put at one position.
/// \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT Revisits find_new_revisits(const Mission& mission, const PosesByKey& poses,
                                                         const SurfaceAgreementOptions& options,
                                                         const PosesByKey& former,
                                                         const SurfaceAgreementOptions& of_former);

/// Share of the path, in stretches of `stretch_m`, that has an end of a revisit; NaN without a path.
/// \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT double revisited_share(const Mission& mission, const PosesByKey& poses,
                                                     const Revisits& revisits, double stretch_m = 20.0);

/// Numbers the revisits by robots and by the stretches of path at their ends. Revisits of one group share the
/// errors of the poses there and much of the scans: they are repetitions, not independent. \throws
/// OptionError; InputError on a node without pose or scan
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::size_t> revisit_groups(const Mission& mission,
                                                                      const PosesByKey& poses,
                                                                      const Revisits& revisits,
                                                                      double stretch_m = 20.0);

/// The agreement of a map.
struct SurfaceAgreement {
  std::vector<double> shares;  ///< Of each revisit: share of the points that lie on the other scan's
                               ///< surfaces; NaN where a pose or a scan is missing.
  std::size_t revisits = 0;    ///< With a share.
  double mean = 0.0;           ///< Of the shares; NaN without revisits.
};

/// Agreement of a map with poses T_world_body. \throws OptionError. An unreadable scan is left out, and is a
/// problem of the mission's scans.
[[nodiscard]] LOOPWISE_EXPORT SurfaceAgreement surface_agreement(const Mission& mission,
                                                                 const PosesByKey& poses,
                                                                 const Revisits& revisits,
                                                                 const SurfaceAgreementOptions& options = {},
                                                                 const StopToken& stop = {});

}  // namespace loopwise
