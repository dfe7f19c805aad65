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
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/fast_registrar.hpp>

namespace loopwise {

/// How align() reads the points of a cloud. Supported: containers with size() and operator[] whose elements
/// have x, y, z (pcl::PointCloud, std::vector of a struct) or are Eigen vectors of three or four coordinates;
/// Eigen matrices with one point per column (three rows); loopwise::PointCloud. For your own type, specialise
/// it with the same two functions.
template <class Cloud, class = void>
struct PointCloudTraits {
  /// Number of points.
  [[nodiscard]] static std::size_t size(const Cloud& cloud) { return static_cast<std::size_t>(cloud.size()); }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const Cloud& cloud, std::size_t i) {
    return coordinates(cloud[i], 0);
  }

 private:
  template <class Point>
  static auto coordinates(const Point& p, int)
      -> decltype(Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                                  static_cast<double>(p.z))) {
    return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
  }
  template <class Point>
  static Eigen::Vector3d coordinates(const Point& p, long) {
    return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
  }
};

/// Eigen matrices with one point per column.
template <class Matrix>
struct PointCloudTraits<Matrix, std::enable_if_t<std::is_base_of_v<Eigen::MatrixBase<Matrix>, Matrix>>> {
  static_assert(Matrix::RowsAtCompileTime == 3 || Matrix::RowsAtCompileTime == Eigen::Dynamic,
                "align() takes matrices of three rows, one column for each point");
  /// Number of points. \throws InputError unless the matrix has three rows.
  [[nodiscard]] static std::size_t size(const Matrix& matrix) {
    if (matrix.rows() != 3) {
      throw InputError("align() takes matrices of 3 rows, one column for each point; found " +
                       std::to_string(matrix.rows()) + " rows");
    }
    return static_cast<std::size_t>(matrix.cols());
  }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const Matrix& matrix, std::size_t i) {
    return matrix.col(static_cast<Eigen::Index>(i)).template cast<double>();
  }
};

/// The cloud of the library. Normals and intensities are not used.
template <>
struct PointCloudTraits<PointCloud> {
  /// Number of points.
  [[nodiscard]] static std::size_t size(const PointCloud& cloud) { return cloud.size(); }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const PointCloud& cloud, std::size_t i) {
    return cloud.origin + cloud.points[i].cast<double>();
  }
};

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

/// align() for points in double precision. \throws OptionError; InputError as align()
[[nodiscard]] LOOPWISE_EXPORT AlignResult align_points(const std::vector<Eigen::Vector3d>& target,
                                                       const std::vector<Eigen::Vector3d>& source,
                                                       const AlignOptions& options = {});

/// Copies the points of a cloud.
template <class Cloud>
[[nodiscard]] std::vector<Eigen::Vector3d> copy_points(const Cloud& cloud) {
  using Traits = PointCloudTraits<Cloud>;
  const std::size_t count = Traits::size(cloud);
  std::vector<Eigen::Vector3d> points;
  points.reserve(count);
  for (std::size_t i = 0; i < count; ++i) points.push_back(Traits::point(cloud, i));
  return points;
}

/// Aligns two lidar scans of one place, in metres, by the FastRegistrar. Points that are not finite are
/// dropped and counted. Clouds that cannot be aligned give a result with a reason, not an exception.
/// Deterministic; safe to call from several threads.
/// \param target the fixed cloud
/// \param source the cloud to align with the target
/// \param options initial guess, preparation of the clouds, registration
/// \throws OptionError; InputError if the guess is not a rigid transform, or if most points of a cloud are
/// more than 16 km from its origin. In that case subtract an offset, because floats lose digits
template <class Target, class Source>
[[nodiscard]] AlignResult align(const Target& target, const Source& source,
                                const AlignOptions& options = {}) {
  return align_points(copy_points(target), copy_points(source), options);
}

}  // namespace loopwise
