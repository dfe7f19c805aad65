// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
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

/// The nearest point to a query, and how far the others are at least.
struct NearestOfTwo {
  Neighbour nearest;          ///< The nearest point.
  float sq_second_m2 = 0.0F;  ///< Squared distance of the second nearest; that of the bound if it is farther.
};

/// Exact nearest-neighbour search over points in 3D. Immutable: any number of threads may search at once.
/// Equal distances are ordered by index: results depend on the points alone. The method is Bentley's
/// (Multidimensional binary search trees, CACM 1975), split at the median of the longest axis. Three levels
/// of splits form one node with the bounding boxes of its eight children, and leaves hold up to eight points,
/// one array per coordinate, so that nodes and leaves are searched with SIMD.
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

  /// The same with the distance of the second nearest point, also within `max_distance_m`. A query that then
  /// moves by less than half of the difference of both distances has the same nearest point.
  [[nodiscard]] std::optional<NearestOfTwo> nearest_of_two(
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
  static constexpr std::size_t kWidth = 8;  // of nodes and leaves
  /// Bounding boxes of the children, by axis.
  struct Node {
    float low[3][kWidth], high[3][kWidth];
  };
  struct Item;
  template <class Points>
  void build(const Points& points);
  template <class Visitor>
  void search(const Eigen::Vector3f& query, Visitor& visitor) const;

  void add_leaf(std::size_t leaf, const Item* begin, const Item* end);
  void bound_nodes(std::size_t leaves);
  [[nodiscard]] std::pair<float, float> extent(std::size_t child, std::size_t axis) const;

  std::size_t size_ = 0, cloud_size_ = 0;
  // A complete tree, level by level. Child i of node k is first_child_ + 8k + i; those beyond the nodes are
  // leaves. The root has two, four or eight children, which are its last ones.
  std::ptrdiff_t first_child_ = 1;
  std::vector<Node> nodes_;
  std::vector<float> x_, y_, z_;         // eight for each leaf; free places are far off
  std::vector<std::uint32_t> original_;  // index of each in the input
};

}  // namespace loopwise
