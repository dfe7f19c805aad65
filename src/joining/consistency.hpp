// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Which closures between two components agree over both odometries. Private to joining.
#pragma once

#include <cstddef>
#include <vector>

#include "component_paths.hpp"

namespace loopwise::joining {

/// A closure between two components by the numbers of its stations.
struct PairClosure {
  std::size_t b = 0;    ///< LoopClosure::from
  std::size_t a = 0;    ///< LoopClosure::to
  LoopClosure closure;  ///< T_from_to is the pose of a in b.
};

/// Closures between two components, and which of them agree. Grows closure by closure.
class ClosureSet {
 public:
  ClosureSet(const ComponentPaths& paths, double threshold) : paths_(paths), threshold_(threshold) {}

  void add(const PairClosure& closure);
  [[nodiscard]] std::size_t size() const { return closures_.size(); }
  [[nodiscard]] const PairClosure& operator[](std::size_t i) const { return closures_[i]; }
  [[nodiscard]] bool agree(std::size_t i, std::size_t j) const { return agrees_[i][j] != 0; }
  /// Share of `group` that closure i agrees with; itself counts as agreeing.
  [[nodiscard]] double agreement(std::size_t i, const std::vector<std::size_t>& group) const;
  /// A large group in which every two agree, of the closures `among`, ascending; by greedy search from every
  /// closure.
  [[nodiscard]] std::vector<std::size_t> largest_group(const std::vector<std::size_t>& among) const;
  /// How many of a group's closures have both ends more than `place_m` from those of the others counted.
  [[nodiscard]] std::size_t places(const std::vector<std::size_t>& group, double place_m) const;
  /// Pose of b's component in that of a that the closure implies.
  [[nodiscard]] Eigen::Isometry3d frame(std::size_t i) const;
  /// Covariance, right perturbation at a's end of the middle closure, that a group leaves by the closures
  /// alone, with odometry's drift between them.
  [[nodiscard]] Matrix6d fused_covariance(const std::vector<std::size_t>& group) const;

 private:
  [[nodiscard]] double loop_error(const PairClosure& x, const PairClosure& y) const;

  const ComponentPaths& paths_;
  double threshold_;
  std::vector<PairClosure> closures_;
  std::vector<std::vector<char>> agrees_;
};

}  // namespace loopwise::joining
