// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>

namespace loopwise::detail {

/// Gain of closures between two places of a graph as a function of their number: A·k/(k + κ).
struct RepeatedGain {
  double most = 0.0;  ///< A: gain of infinitely many, m².
  double half = 1.0;  ///< κ: the number of closures with half of that gain.
  [[nodiscard]] double of(double closures) const { return most * closures / (closures + half); }
};

/// Random probes of a graph's covariance, stored for all nodes. They predict the gain of closures between any
/// two nodes in about a microsecond each. Like sketched_gains(), in single precision.
class RelativeSketch {
 public:
  /// An empty sketch, in which all gains are 0.
  RelativeSketch() = default;
  /// \throws InputError if the graph leaves a pose undetermined
  RelativeSketch(const PoseGraph& graph, const ClosureModelOptions& options, std::size_t probes,
                 std::uint64_t seed);

  [[nodiscard]] bool empty() const { return nodes_ == 0; }
  [[nodiscard]] std::size_t nodes() const { return nodes_; }
  /// Gain of closures between two nodes that the sketched graph had, at their present poses.
  [[nodiscard]] RepeatedGain gain(std::size_t from, std::size_t to, const Eigen::Isometry3d& T_to_from) const;

 private:
  std::size_t nodes_ = 0, probes_ = 0;
  Vector6d whitening_ = Vector6d::Ones();  // 1/sigma of each coordinate
  std::vector<float> U_, V_;               // 6×probes row-major per node, by node of the graph
};

}  // namespace loopwise::detail
