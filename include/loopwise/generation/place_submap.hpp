// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise {

/// Scans that are merged before a place is described.
struct PlaceSubmapOptions {
  /// Scans at most this far before and after the node along the odometry are merged with its scan, m. 0: only
  /// its own scan.
  double path_m = 15.0;
  /// Minimum distance along the odometry between merged scans, m. Scans closer to the previous one are
  /// skipped.
  double spacing_m = 1.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("path_m", self.path_m, at_least(0.0));
    field("spacing_m", self.spacing_m, at_least(0.0));
  }
};

/// The surroundings of a node as a robot saw them, in the node's level frame (see features/place.hpp).
struct PlaceSubmap {
  PointCloud level;  ///< Points of all scans, without normals.
  /// level_rotation() of the node, by which the cloud was rotated.
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
};

/// Merges the scan of a node with those of its neighbours along the odometry, as far as they are in the
/// graph. Neighbours whose scan is missing are left out. Empty if the node's own scan is missing.
/// \param graph holds the node; its z axis points up
/// \param robots of its keys
/// \param centre the node
/// \param scans their clouds in body frames, best downsampled
/// \param options which scans are merged
/// \throws UnknownKeyError; exceptions of `scans`
[[nodiscard]] LOOPWISE_EXPORT PlaceSubmap place_submap(const PoseGraph& graph, const Robots& robots,
                                                       Key centre, const ScanLoader& scans,
                                                       const PlaceSubmapOptions& options = {});

}  // namespace loopwise
