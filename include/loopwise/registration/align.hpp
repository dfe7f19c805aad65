// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Registration of two clouds in one call.
///
///     const loopwise::AlignResult result = loopwise::align(target, source);
///     if (result.success) use(result.T_target_source);
#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/point_cloud.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/fast_registrar.hpp>

namespace loopwise {

/// Options of align().
struct AlignOptions {
  /// Initial T_target_source, which is tried first. A result farther from it than FastRegistrarOptions::tests
  /// allows (20 m, 50 degrees) is rejected. Empty: no guess.
  std::optional<Eigen::Isometry3d> guess;
  FeatureOptions features;            ///< Downsampling and normals; points beyond max_range_m are left out.
  FastRegistrarOptions registration;  ///< Registration and its tests.
  double time_limit_s = 0.0;          ///< Wall time after which align() gives up, s; 0: no limit.
};

/// The result of align().
struct AlignResult {
  bool success = false;                             ///< The alignment has passed all tests.
  RejectionReason reason = RejectionReason::kNone;  ///< kNone if successful; otherwise see enum_name().
  std::string message;  ///< For users: figures and their bounds. Empty if successful.
  /// Maps points of the source to the frame of the target: p_target = T_target_source · p_source. NaN unless
  /// successful.
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  /// Covariance of T_target_source: right perturbation T_target_source · Exp(ξ), that is, in the frame of the
  /// source; order [translation, rotation], m² and rad². NaN unless successful.
  Matrix6d covariance = Matrix6d::Identity();
  /// Share of source points with a target point within ClosureTestOptions::overlap_distance_m, [0, 1]; NaN if
  /// not measured.
  double inlier_share = 0.0;
  std::size_t dropped_target_points =
      0;  ///< Points left out: not finite, or beyond FeatureOptions::max_range_m.
  std::size_t dropped_source_points = 0;  ///< The same for the source.
};

/// Aligns two lidar scans of one place, in metres, by the FastRegistrar. Clouds of any type convert to a
/// PointView; both are copied once, downsampled. Points that are not finite are dropped and counted. Clouds
/// that cannot be aligned give a result with a reason, not an exception. Deterministic; safe to call from
/// several threads.
/// \param target the fixed cloud
/// \param source the cloud to align with the target
/// \param options initial guess, preparation of the clouds, registration
/// \throws OptionError; InputError if the guess is not a rigid transform, or if most points of a cloud are
/// more than 16 km from its origin. In that case subtract an offset, because floats lose digits
[[nodiscard]] LOOPWISE_EXPORT AlignResult align(PointView target, PointView source,
                                                const AlignOptions& options = {});

}  // namespace loopwise
