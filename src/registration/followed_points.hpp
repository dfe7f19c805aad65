// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Nearest target points of source points that move in small steps. A point keeps its nearest one as long as
/// it has moved less than half of the difference between the distances of the two nearest, and has none as
/// long as it cannot have come within reach. Most searches of a refinement are thus left out. What is found
/// is what a search would find, whatever was searched before.
class FollowedPoints {
 public:
  /// \param tree of the target; must outlive the object
  /// \param count number of source points
  FollowedPoints(const KdTree& tree, std::size_t count) : tree_(tree), points_(count) {}

  /// The target point nearest to source point k, which is now at `query`, if it is within `reach`.
  /// \param points of the target, by the indices of the tree
  template <class Points>
  [[nodiscard]] std::optional<Neighbour> nearest(std::size_t k, const Eigen::Vector3f& query, float reach,
                                                 const Points& points) {
    Followed& point = points_[k];
    const float moved = (query - point.at).norm();
    const bool known = point.nearest == kNone ? moved + reach < point.slack : moved < point.slack;
    if (!known) search(point, query, reach, moved);
    if (point.nearest == kNone) return std::nullopt;
    const Eigen::Vector3f d = points[point.nearest] - query;
    const float sq_distance = d.x() * d.x() + d.y() * d.y() + d.z() * d.z();
    if (sq_distance > reach * reach) return std::nullopt;
    return Neighbour{point.nearest, sq_distance};
  }

 private:
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  struct Followed {
    Eigen::Vector3f at = Eigen::Vector3f::Zero();  // where the last search was
    float slack = 0.0F;   // the point may move by this; without a nearest one, the radius that holds none
    float second = 0.0F;  // radius that holds the two nearest, if there is a nearest one
    std::uint32_t nearest = kNone;
  };

  void search(Followed& point, const Eigen::Vector3f& query, float reach, float moved) const {
    // Beyond the reach, so that the next searches of a point without a match are left out as well.
    constexpr float kBeyond = 1.25F;
    constexpr float kRounding = 1e-4F;  // above the rounding errors of distances up to a hundred metres
    float bound = kBeyond * reach;
    if (point.nearest != kNone) bound = std::min(bound, point.second + moved + kRounding);
    const std::optional<NearestOfTwo> found = tree_.nearest_of_two(query, bound);
    point.at = query;
    if (!found) {
      point.nearest = kNone;
      point.slack = bound - kRounding;
      return;
    }
    point.nearest = found->nearest.index;
    point.second = std::sqrt(found->sq_second_m2);
    point.slack = 0.5F * (point.second - std::sqrt(found->nearest.sq_distance_m2)) - kRounding;
  }

  const KdTree& tree_;
  std::vector<Followed> points_;
};

}  // namespace loopwise
