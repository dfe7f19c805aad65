// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// Covariances of relative poses by odometry and priors alone: neither closures nor estimates change them,
/// so a growing graph always gives the same values for a pair. First order in the noise.
class LOOPWISE_EXPORT OdometryCovariances {
 public:
  /// Takes in the present nodes, odometry and priors of the graph. O(new nodes) for nodes that continue known
  /// chains, and the counting of all edges; O(nodes) if odometry or a prior joined known chains.
  void update(const PoseGraph& graph);

  /// Covariance of T_from_to over the right perturbation, order translation, rotation, m² and rad². Nothing
  /// where update() has not seen a node, or where neither odometry nor priors join both.
  /// \param from,to nodes, by their index in the graph
  [[nodiscard]] std::optional<Matrix6d> between(std::size_t from, std::size_t to) const;

 private:
  /// A node in a tree of odometry. The error of its pose is on the left, T = Exp(η) T̄, so that the errors of
  /// steps add up along a path.
  struct Place {
    std::uint32_t root = 0, parent = 0, depth = 0;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();  // along odometry from the root
    Matrix6d covariance = Matrix6d::Zero();                  // of η, including the prior of the root
    bool anchored = false;                                   // of a root: it has a prior
  };

  [[nodiscard]] bool append(const PoseGraph& graph);
  void rebuild(const PoseGraph& graph);
  [[nodiscard]] Place continued(const PoseGraph& graph, std::size_t edge, std::uint32_t from) const;

  std::vector<Place> places_;
  std::size_t odometry_edges_ = 0, priors_ = 0;
};

}  // namespace loopwise
