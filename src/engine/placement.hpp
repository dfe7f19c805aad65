// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise {

/// Poses of nodes before any estimate: odometry and full priors determine them, in order of arrival. Nodes
/// that odometry joins form a group, which moves as a whole until its place is fixed.
class Placement {
 public:
  explicit Placement(Robots robots) : robots_(std::move(robots)) {}

  /// Whether the prior can place a path: it must have information on rotation and position (GNSS has no
  /// rotation).
  [[nodiscard]] static bool is_full(const PriorFactor& prior);

  /// Factors that are known when a node arrives.
  struct Known {
    std::vector<const Edge*> edges;
    std::vector<const PriorFactor*> priors;
  };
  /// Adds a node that is not yet in the graph. \returns its pose
  [[nodiscard]] Eigen::Isometry3d add(const PoseGraph& graph, const Node& node, const Known& known);

  /// A group that has to move as a whole, so that `anchor` gets the pose `pose`.
  struct Move {
    std::vector<Key> group;
    Key anchor = 0;
    Eigen::Isometry3d pose;
  };
  /// Joins the groups of two nodes of the graph by odometry. The group whose place is less certain moves; if
  /// both are equally certain, the smaller one. Two fixed groups stay.
  [[nodiscard]] std::optional<Move> tie(const PoseGraph& graph, const Edge& edge);
  /// Applies a prior of a node of the graph. \returns the group that the prior fixes, unless it was already
  /// fixed
  [[nodiscard]] std::optional<Move> settle(const PoseGraph& graph, const PriorFactor& prior);
  /// Marks the place of the node's group as fixed by an estimate.
  void fix(Key key) { groups_.at(group_of_.at(key)).place = Place::kFixed; }

  /// Whether one of the two nodes may still move without the other.
  [[nodiscard]] bool apart(Key first, Key second) const;

  /// Poses by odometry and full priors alone, in the order of the graph's nodes.
  [[nodiscard]] const std::vector<Eigen::Isometry3d>& odometry() const { return odometry_; }

 private:
  /// The source of a group's place, in ascending order of certainty.
  enum class Place {
    kGiven,  ///< The front end's pose.
    kFirst,  ///< It contains its robot's first node, which defines the robot's frame.
    kFixed,  ///< A full prior or an estimate.
  };
  struct Group {
    Place place = Place::kGiven;
    std::vector<Key> nodes;
  };
  /// The neighbour from which a new node is placed, and the relative pose.
  struct Step {
    std::size_t node;
    Eigen::Isometry3d T;
  };
  [[nodiscard]] std::optional<Step> step_to(const PoseGraph& graph, Key key, const Known& known) const;
  void join(Key key, std::optional<Key> member, Place place);
  void move_odometry(const PoseGraph& graph, const Move& move, const Eigen::Isometry3d& pose);

  Robots robots_;
  std::unordered_set<std::size_t> begun_;  // robots with a node
  std::unordered_map<Key, std::size_t> group_of_;
  std::map<std::size_t, Group> groups_;
  std::size_t next_ = 0;
  std::vector<Eigen::Isometry3d> odometry_;
};

}  // namespace loopwise
