// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Consistency of closures between two components, given the odometry of both. Private to joining.
#pragma once

#include <cstddef>
#include <vector>

#include "component_paths.hpp"

namespace loopwise::joining {

/// A closure between two components by the numbers of its nodes.
struct PairClosure {
  std::size_t b = 0;    ///< LoopClosure::from
  std::size_t a = 0;    ///< LoopClosure::to
  LoopClosure closure;  ///< T_from_to is the pose of a in b.
};

/// Closures between two components and their pairwise agreement. Grows closure by closure.
class ClosureSet {
 public:
  ClosureSet(const ComponentPaths& paths, double threshold) : paths_(paths), threshold_(threshold) {}

  void add(const PairClosure& closure);
  [[nodiscard]] std::size_t size() const { return closures_.size(); }
  [[nodiscard]] const PairClosure& operator[](std::size_t i) const { return closures_[i]; }
  [[nodiscard]] bool agree(std::size_t i, std::size_t j) const { return agrees_[i][j] != 0; }
  /// Share of `group` that agrees with closure i. A closure agrees with itself.
  [[nodiscard]] double agreement(std::size_t i, const std::vector<std::size_t>& group) const;
  /// A large group of closures that agree pairwise, found greedily from each closure of `among` (ascending).
  [[nodiscard]] std::vector<std::size_t> largest_group(const std::vector<std::size_t>& among) const;
  /// Number of distinct places of a group: closures with both ends more than `place_m` from those counted
  /// before.
  [[nodiscard]] std::size_t places(const std::vector<std::size_t>& group, double place_m) const;
  /// Pose of b's component in the frame of a's component that the closure implies.
  [[nodiscard]] Eigen::Isometry3d frame(std::size_t i) const;
  /// Covariance of the pose between the components from a group's closures alone, with odometry's drift
  /// between them. Right perturbation at a's end of the middle closure.
  [[nodiscard]] Matrix6d fused_covariance(const std::vector<std::size_t>& group) const;

 private:
  [[nodiscard]] double loop_error(const PairClosure& x, const PairClosure& y) const;

  const ComponentPaths& paths_;
  double threshold_;
  std::vector<PairClosure> closures_;
  std::vector<std::vector<char>> agrees_;
};

}  // namespace loopwise::joining
