// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Thickness of surfaces that two scans of one place share: a wall that a map shows twice is thick.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// A pair of nodes whose scans a registration aligned.
struct ProvenRevisit {
  Key from = 0;                 ///< Key of the newer node.
  Key to = 0;                   ///< Key of the older node.
  Eigen::Isometry3d T_from_to;  ///< As measured.
};

/// Points of one scan on a surface, in the frame of the scan.
struct SurfacePoints {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();        ///< m.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< m².
};

/// A piece of a plane that both scans of a revisit saw.
struct SharedPlane {
  Eigen::Vector3d normal =
      Eigen::Vector3d::UnitZ();  ///< In the frame of `from`, where both scans are aligned.
  SurfacePoints from;            ///< Of the newer scan.
  SurfacePoints to;              ///< Of the older scan.

  /// Standard deviation along the normal of the points of both scans, which weigh the same, if `to` lies at
  /// T_from_to, m. Two sheets at a distance d have at least d / 2.
  [[nodiscard]] LOOPWISE_EXPORT double thickness_m(const Eigen::Isometry3d& T_from_to) const;
};

/// The planes that both scans of a revisit have after its registration aligned them: cells of 1 m
/// with at least 4 points of each scan, flat in both together. Fixed by the registration, they are the same
/// surfaces for every map.
[[nodiscard]] LOOPWISE_EXPORT std::vector<SharedPlane> shared_planes(const PointCloud& from,
                                                                     const PointCloud& to,
                                                                     const Eigen::Isometry3d& T_from_to);

/// The planes of each revisit. A scan that cannot be read gives no planes, and is a problem of the mission's
/// scans.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::vector<SharedPlane>> shared_planes(
    const Mission& mission, const std::vector<ProvenRevisit>& revisits, const StopToken& stop = {});

}  // namespace loopwise
