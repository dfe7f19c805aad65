// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/point_cloud.hpp>

namespace loopwise {

/// A point found by a KdTree.
struct Neighbour {
  std::uint32_t index = 0;   ///< Of the point in the cloud that the tree was built from.
  float sq_distance_m2 = 0;  ///< Squared distance to the query.
};

/// Exact nearest-neighbour search over points in 3D. Immutable: any number of threads may search at once.
/// Leaves hold a few points, one array per coordinate, so that a leaf is searched with SIMD. Equal distances
/// are ordered by index: results depend on the points alone. The method is Bentley's (Multidimensional binary
/// search trees, CACM 1975), split at the median of the longest axis, with leaves of up to 12 points.
class LOOPWISE_EXPORT KdTree {
 public:
  KdTree() = default;
  /// Builds the tree of a cloud, O(n log n), m. Reads the cloud in place and copies the coordinates in single
  /// precision into the order of the leaves: the cloud may change or end afterwards. Points that are not
  /// finite are left out; equal points are fine.
  /// \throws InputError if there are 2^31 points or more, or if points in double precision are in world
  /// coordinates, where a float loses digits
  explicit KdTree(PointView points);

  /// Number of points in the tree.
  [[nodiscard]] std::size_t size() const { return size_; }
  /// Number of points of the cloud, with those that were left out.
  [[nodiscard]] std::size_t cloud_size() const { return cloud_size_; }
  /// Whether there is no point.
  [[nodiscard]] bool empty() const { return size_ == 0; }

  /// The nearest point within `max_distance_m`, if there is one. A query that is not finite finds no point,
  /// here and below.
  [[nodiscard]] std::optional<Neighbour> nearest(
      const Eigen::Vector3f& query, float max_distance_m = std::numeric_limits<float>::infinity()) const;

  /// Replaces `found` by the `count` nearest points, or all if fewer exist, nearest first.
  void nearest(const Eigen::Vector3f& query, std::size_t count, std::vector<Neighbour>& found) const;

  /// Replaces `found` by all points within `radius_m`, nearest first.
  void within(const Eigen::Vector3f& query, float radius_m, std::vector<Neighbour>& found) const;
  /// The same in the order of the tree, which costs less.
  void within_unordered(const Eigen::Vector3f& query, float radius_m, std::vector<Neighbour>& found) const;

  /// Memory that the tree holds, for bounded caches.
  [[nodiscard]] std::size_t bytes() const;

 private:
  /// Inner nodes of a complete binary tree in heap order: children of i are 2i+1 and 2i+2.
  struct Split {
    float low = 0;   ///< Largest coordinate on the lower side.
    float high = 0;  ///< Smallest coordinate on the upper side.
    std::uint32_t axis = 0;
  };
  template <class Points>
  void build(const Points& points);
  template <class Visitor>
  void search(const Eigen::Vector3f& query, Visitor& visitor) const;

  std::size_t size_ = 0, cloud_size_ = 0;
  int depth_ = 0;                          // of the leaves; there are 2^depth of them
  std::vector<Split> splits_;              // 2^depth − 1
  std::vector<std::uint32_t> leaf_begin_;  // 2^depth + 1, positions in the arrays below
  std::vector<float> x_, y_, z_;           // in the order of the leaves
  std::vector<std::uint32_t> original_;    // index of each in the input
};

}  // namespace loopwise
