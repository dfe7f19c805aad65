// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

/// What a cloud looks like from above: for each column of a square grid around the sensor, how many voxels of
/// the column hold points. Ground alone counts one, a wall as many as it is high.
struct DensityImage {
  float cell_m = 0.0F;                ///< Edge of the columns and voxels.
  int size = 0;                       ///< Columns along each axis.
  float ground_m = 0.0F;              ///< Height of the ground near the sensor, in the frame of the cloud.
  std::vector<std::uint8_t> heights;  ///< size² of them, row by row; 0: nothing was seen.

  /// Column of a coordinate; outside [0, size) beyond the image.
  [[nodiscard]] int column(float coordinate_m) const;
  /// Coordinate of the middle of a column.
  [[nodiscard]] float middle(float column) const {
    return (column + 0.5F - 0.5F * static_cast<float>(size)) * cell_m;
  }
};

/// The image of a cloud in its level frame.
[[nodiscard]] DensityImage density_image(const PointCloud& level, double cell_m, double range_m);

/// Height of the ground near the sensor: one in ten of the points within 8 m lies below, or, where there are
/// few, one in fifty of all.
[[nodiscard]] float ground_height(const std::vector<Eigen::Vector3f>& points);

/// A key point of a density image with what surrounds it.
struct PlaceFeature {
  static constexpr std::size_t kWords = 4;
  Eigen::Vector2f position = Eigen::Vector2f::Zero();  ///< In the level frame, m.
  float angle = 0.0F;                                  ///< Its own direction, rad: turns with the frame.
  std::array<std::uint64_t, kWords> bits{};            ///< Similar surroundings differ in few bits.
};

/// In how many bits two features differ.
[[nodiscard]] int differing_bits(const PlaceFeature& a, const PlaceFeature& b);

/// The most pronounced corners and poles of an image, strongest first. Features that another one of the image
/// resembles are left out: they say nothing of where they are.
[[nodiscard]] std::vector<PlaceFeature> place_features(const DensityImage& image, std::size_t most);

}  // namespace loopwise
