// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise {

/// Which scans are put together before a place is described.
struct PlaceSubmapOptions {
  double path_m = 15.0;
  double spacing_m = 1.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("path_m", self.path_m, at_least(0.0),
          "Scans before and after the node whose distance along the odometry is at most this are merged with "
          "its scan, m; 0: none.");
    field("spacing_m", self.spacing_m, at_least(0.0),
          "Of these, such that are nearer along the odometry to the last one are left out, m.");
  }
};

/// The surroundings of a node as a robot saw them, in the node's level frame (see features/place.hpp).
struct PlaceSubmap {
  PointCloud level;  ///< Points of all scans, without normals.
  /// level_rotation() of the node that the cloud was turned by.
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
};

/// Merges the scan of a node with those of its neighbours along the odometry, as far as they are in the
/// graph. Neighbours whose scan is missing are left out. Empty if the node's own scan is missing.
/// \param graph holds the node; its z axis points up
/// \param robots of its keys
/// \param centre the node
/// \param scans their clouds in body frames, best downsampled
/// \param options how far to go
/// \throws UnknownKeyError; what `scans` throws
[[nodiscard]] LOOPWISE_EXPORT PlaceSubmap place_submap(const PoseGraph& graph, const Robots& robots,
                                                       Key centre, const ScanLoader& scans,
                                                       const PlaceSubmapOptions& options = {});

}  // namespace loopwise
