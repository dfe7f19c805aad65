// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Registration of two single clouds, which may be in world coordinates, with a configured registrar.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/registration/cloud_origins.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise {

/// The registration of a source to a target. Poses are T_target_source: they map points of the source into
/// the frame of the target.
struct CloudPairResult {
  RegistrationResult result;  ///< As of a loop candidate from the source (node 1) to the target (node 0).
  /// The points that T_origins refers to, see origins_to_report().
  CloudOrigins origins;
  /// The pose relative to PointCloud::origin of each cloud; empty if no pose was found.
  std::optional<Eigen::Isometry3d> T_clouds;
  std::optional<Eigen::Isometry3d> T_coordinates;  ///< The same pose in the clouds' own coordinates.
  std::optional<Eigen::Isometry3d> T_origins;      ///< The same pose about the origins.
  std::optional<Matrix6d> covariance;              ///< Of T_origins; empty unless it was verified.
  std::size_t far_points_source = 0;               ///< Points that were left out as too far from the sensor.
  std::size_t far_points_target = 0;               ///< The same of the target.
};

/// Registers the source to the target. For a pair of many, make_registration() keeps features of clouds.
/// \param source cloud to move
/// \param target cloud that stays
/// \param options of the registrar and its features
/// \param guess T_target_source in the clouds' own coordinates; results far from it are rejected
/// \param seed of all random draws
/// \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT CloudPairResult
register_clouds(std::shared_ptr<const PointCloud> source, std::shared_ptr<const PointCloud> target,
                const RegistrationOptions& options = {},
                const std::optional<Eigen::Isometry3d>& guess = std::nullopt, std::uint64_t seed = 1);

}  // namespace loopwise
