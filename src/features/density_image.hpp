// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/keyed_scan.hpp>

#include "similar_bits.hpp"

namespace loopwise {

/// A cloud seen from above. Each column of a square grid around the sensor has the number of its voxels that
/// hold points: one for ground alone, its height in voxels for a wall.
struct DensityImage {
  float cell_m = 0.0F;                ///< Edge of the columns and voxels.
  int size = 0;                       ///< Columns along each axis.
  float ground_m = 0.0F;              ///< Height of the ground near the sensor, in the frame of the cloud.
  std::vector<std::uint8_t> heights;  ///< size² values, row by row; 0 where nothing was seen.

  /// Column of a coordinate; outside [0, size) beyond the image.
  [[nodiscard]] int column(float coordinate_m) const;
  /// Coordinate of the middle of a column.
  [[nodiscard]] float middle(float column) const {
    return (column + 0.5F - 0.5F * static_cast<float>(size)) * cell_m;
  }
};

/// The image of a cloud in its level frame.
[[nodiscard]] DensityImage density_image(const PointCloud& level, double cell_m, double range_m);

/// Height of the ground near the sensor: the 10 % quantile of the heights of points within 8 m, or the 2 %
/// quantile of all points if few are near.
[[nodiscard]] float ground_height(const std::vector<Eigen::Vector3f>& points);

/// A key point of a density image with a descriptor of its surroundings.
struct PlaceFeature {
  PlaceBits bits;                                      ///< Descriptor of the surroundings.
  Eigen::Vector2f position = Eigen::Vector2f::Zero();  ///< In the level frame, m.
  float angle = 0.0F;  ///< Direction of the key point in the level frame, rad.
};

/// The most pronounced corners and poles of an image, strongest first. Features that resemble another one of
/// the same image are left out, because their position is ambiguous.
[[nodiscard]] std::vector<PlaceFeature> place_features(const DensityImage& image, std::size_t most);

}  // namespace loopwise
