// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include <Eigen/Core>

#include <loopwise/registration/closure_tests.hpp>

#include "range_image.hpp"
#include "submap.hpp"

namespace loopwise {

/// Data of one side of a registration, without descriptors.
class Side {
 public:
  Submap submap;
  std::vector<std::uint32_t> order;  ///< Points with a normal, see draw_balanced.
  RangeImage range_image;            ///< Of the centre's scan.
  SurfaceShare share;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< Middle of the points, see robust_centre().

  /// plane_neighbours() of the cloud. Computed on first use, because most pairs are rejected before. May be
  /// called from several threads; `options` must always be the same.
  [[nodiscard]] const std::vector<PlaneNeighbour>& neighbours(const ClosureTestOptions& options) const {
    std::call_once(lazy_->once,
                   [&] { lazy_->neighbours = plane_neighbours(submap.cloud(), submap.tree(), options); });
    return lazy_->neighbours;
  }

  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + submap.bytes() + order.capacity() * sizeof(std::uint32_t) + range_image.bytes() +
           submap.cloud().size() * sizeof(PlaneNeighbour);
  }

 private:
  struct Lazy {
    std::once_flag once;
    std::vector<PlaneNeighbour> neighbours;
  };
  std::shared_ptr<Lazy> lazy_ = std::make_shared<Lazy>();
};

}  // namespace loopwise
