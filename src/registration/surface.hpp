// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <Eigen/Core>

#include <loopwise/core/point_cloud.hpp>

namespace loopwise {

/// Points and normals as arrays, as the library stores them.
struct SurfaceArrays {
  const Eigen::Vector3f* points;
  const Eigen::Vector3f* normals;
};

/// Points and normals in any memory. Normals that are not finite are read as unknown ones.
struct SurfaceReader {
  struct Normals {
    PointView view;
    [[nodiscard]] Eigen::Vector3f operator[](std::size_t i) const {
      const Eigen::Vector3f normal = view[i].cast<float>();
      return normal.allFinite() ? normal : Eigen::Vector3f::Zero();
    }
  };
  explicit SurfaceReader(const PointNormalView& cloud) : points{cloud.points()}, normals{cloud.normals()} {}
  detail::SinglePoints points;
  Normals normals;
};

/// The points and normals of a cloud of the library, relative to its origin.
[[nodiscard]] inline PointNormalView surface_of(const PointCloud& cloud) {
  return {cloud.points, cloud.normals};
}

/// Whether points and normals are arrays.
[[nodiscard]] inline bool is_array(const PointNormalView& cloud) {
  return cloud.points().array() != nullptr && cloud.normals().array() != nullptr;
}
[[nodiscard]] inline SurfaceArrays arrays_of(const PointNormalView& cloud) {
  return {cloud.points().array(), cloud.normals().array()};
}

/// Whether all normals are finite. \throws InputError naming `what` if one is neither unknown nor of unit
/// length
[[nodiscard]] bool check_normals(const char* what, const PointNormalView& cloud);

}  // namespace loopwise
