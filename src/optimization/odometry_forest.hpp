// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise::detail {

/// Ω⁻¹, or nothing if Ω is singular.
[[nodiscard]] std::optional<Matrix6d> covariance_of(const Matrix6d& information);

/// The edges that are odometry or trusted, by edge.
[[nodiscard]] std::vector<char> known_inliers(const PoseGraph& graph);

/// Trees of known inliers (odometry, trusted edges), with poses chained along them and their covariances.
/// Roots are the nodes with priors, then the first remaining node. The error of a pose is on its left, T =
/// Exp(η) T̄, so that the errors of steps add up along a path. The error between two nodes is the sum over
/// the steps that only one of their paths from the root contains. First order in the noise.
class OdometryForest {
 public:
  explicit OdometryForest(const PoseGraph& graph);
  /// Trees of the edges in `in_tree` (by edge), with the fewest edges from the root.
  OdometryForest(const PoseGraph& graph, const std::vector<char>& in_tree);

  [[nodiscard]] const Eigen::Isometry3d& pose(std::size_t node) const { return poses_[node]; }
  [[nodiscard]] std::uint32_t root(std::size_t node) const { return root_[node]; }
  /// Covariance of η_b − η_a; nothing if neither a tree nor priors on both join the nodes.
  [[nodiscard]] std::optional<Matrix6d> between(std::size_t a, std::size_t b) const;
  /// Position in an Euler tour of the trees. Down a chain, the difference of two positions is the number of
  /// steps; in general the number of steps between two nodes of a tree is at most this difference.
  [[nodiscard]] std::uint32_t place(std::size_t node) const { return first_visit_[node]; }

 private:
  void grow(const PoseGraph& graph, std::uint32_t from, const std::vector<char>& in_tree);
  void index_ancestors();
  [[nodiscard]] std::uint32_t common_ancestor(std::size_t a, std::size_t b) const;
  [[nodiscard]] std::uint32_t higher(std::uint32_t a, std::uint32_t b) const {
    return depth_[a] <= depth_[b] ? a : b;
  }

  std::vector<std::uint32_t> parent_, root_, depth_;
  std::vector<Eigen::Isometry3d> poses_;
  std::vector<Matrix6d> covariance_;  // of η relative to the root, including the root's prior
  std::vector<char> anchored_;        // by root
  // The Euler tour, and the highest node of each of its ranges whose length is a power of two.
  std::vector<std::uint32_t> first_visit_;
  std::vector<std::vector<std::uint32_t>> highest_;
};

}  // namespace loopwise::detail
