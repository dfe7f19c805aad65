// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Paths of the components, and the possible drift of odometry along them. Private to joining.
#pragma once

#include <cstddef>
#include <unordered_map>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/joining/join.hpp>

namespace loopwise::joining {

/// Isotropic variances of a relative pose.
struct Drift {
  double translation_m2 = 0.0;
  double rotation_rad2 = 0.0;

  [[nodiscard]] Matrix6d covariance() const {
    Matrix6d out = Matrix6d::Zero();
    out.diagonal() << translation_m2, translation_m2, translation_m2, rotation_rad2, rotation_rad2,
        rotation_rad2;
    return out;
  }
};

/// A key frame of a component.
struct PathNode {
  Key key = 0;
  std::size_t component = 0;
  std::size_t path = 0;      ///< Stretch of unbroken odometry, numbered over all components.
  double path_length_m = 0;  ///< From the beginning of the path.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();  ///< In the component's frame.
  Drift since_start;                                       ///< Along the path.
};

/// The key frames of all components by component, in the order of the paths.
class ComponentPaths {
 public:
  /// \throws UnknownKeyError; InputError on a planar graph or a key in two components
  ComponentPaths(const PoseGraph& graph, const std::vector<JoinComponent>& components,
                 const JoinOptions& options);

  [[nodiscard]] std::size_t components() const { return ranges_.size(); }
  [[nodiscard]] const std::vector<PathNode>& nodes() const { return nodes_; }
  [[nodiscard]] const PathNode& operator[](std::size_t station) const { return nodes_[station]; }
  [[nodiscard]] std::size_t begin(std::size_t component) const { return ranges_[component].first; }
  [[nodiscard]] std::size_t end(std::size_t component) const { return ranges_[component].second; }
  /// Number of the key's node. \throws UnknownKeyError
  [[nodiscard]] std::size_t of(Key key) const;
  [[nodiscard]] bool contains(Key key) const { return number_.count(key) != 0; }

  /// Drift of the pose of b in the frame of a. Both belong to one component.
  [[nodiscard]] Drift between(std::size_t a, std::size_t b) const;

 private:
  double drift_m2_per_m_ = 0.0, drift_rad2_per_m_ = 0.0;
  std::vector<PathNode> nodes_;
  std::vector<std::pair<std::size_t, std::size_t>> ranges_;
  std::unordered_map<Key, std::size_t> number_;
};

}  // namespace loopwise::joining
