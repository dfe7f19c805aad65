// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/point_cloud.hpp>

namespace loopwise {

/// Number of finite points further than `max_range_m` from the sensor at zero, or from the median of the
/// points if that is beyond 300 m and the range, as in world coordinates. 0 if the range is 0.
[[nodiscard]] LOOPWISE_EXPORT std::size_t points_beyond(const PointCloud& cloud, double max_range_m);

/// The cloud without these points.
[[nodiscard]] LOOPWISE_EXPORT PointCloud within_range(const PointCloud& cloud, double max_range_m);

/// One point per occupied cube of edge `voxel_m`: the mean of its points (and intensities; normals are
/// averaged and normalised again). Cubes come in the order of their first point, so the result depends on the
/// input alone, and a cloud with at most one point in each cube is unchanged. Points that are not finite are
/// left out. O(n). \throws OptionError unless voxel_m > 0.
[[nodiscard]] LOOPWISE_EXPORT PointCloud voxel_downsample(const PointCloud& cloud, double voxel_m);

/// The same for a cloud of any type, which is read in place: the mean positions alone, m. If the median of
/// the points is more than 16 km from zero, as in world coordinates, the result has an origin there, and its
/// points keep their digits relative to it; otherwise the origin is zero. \throws OptionError unless voxel_m
/// > 0.
[[nodiscard]] LOOPWISE_EXPORT PointCloud voxel_downsample(PointView points, double voxel_m);

/// voxel_downsample for sparse scans too: a cloud of at most `min_points` points keeps all of them. If the
/// grid leaves fewer points, its edge is halved, up to three times, until it leaves enough.
[[nodiscard]] LOOPWISE_EXPORT PointCloud adaptive_downsample(const PointCloud& cloud, double voxel_m,
                                                             std::size_t min_points);

}  // namespace loopwise
