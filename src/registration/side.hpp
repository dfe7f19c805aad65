// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/registration/closure_tests.hpp>

#include "range_image.hpp"
#include "submap.hpp"

namespace loopwise {

/// Data of one side of a registration, without descriptors.
struct Side {
  Submap submap;
  std::vector<std::uint32_t> order;  ///< Points with a normal, see draw_balanced.
  RangeImage range_image;            ///< Of the centre's scan.
  SurfaceShare share;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< Middle of the points, see robust_centre().
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + submap.bytes() + order.capacity() * sizeof(std::uint32_t) + range_image.bytes();
  }
};

}  // namespace loopwise
