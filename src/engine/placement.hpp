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

/// Where nodes lie before any estimate: odometry and full priors place them, whichever comes first. Nodes
/// that odometry has tied together form a group, which moves as one until its place is known. This is the
/// one place that decides it.
class Placement {
 public:
  explicit Placement(Robots robots) : robots_(std::move(robots)) {}

  /// A prior that says nothing of the rotation (as of GNSS) or of the position cannot place a path.
  [[nodiscard]] static bool is_full(const PriorFactor& prior);

  /// Factors that are known when a node arrives.
  struct Known {
    std::vector<const Edge*> edges;
    std::vector<const PriorFactor*> priors;
  };
  /// Takes in a node that the graph does not have yet. \returns its pose
  [[nodiscard]] Eigen::Isometry3d add(const PoseGraph& graph, const Node& node, const Known& known);

  /// Nodes that have to move as one, so that `anchor` lies at `pose`.
  struct Move {
    std::vector<Key> group;
    Key anchor = 0;
    Eigen::Isometry3d pose;
  };
  /// Odometry between two nodes of the graph. Of two groups the one that knows less of its place moves, of
  /// two alike the smaller; groups that are both fixed stay.
  [[nodiscard]] std::optional<Move> tie(const PoseGraph& graph, const Edge& edge);
  /// A prior of a node of the graph. \returns the group that it fixes, if that was not fixed before
  [[nodiscard]] std::optional<Move> settle(const PoseGraph& graph, const PriorFactor& prior);
  /// The node's place is known from an estimate.
  void fix(Key key) { groups_.at(group_of_.at(key)).place = Place::kFixed; }

  /// Whether one of the two may still move without the other.
  [[nodiscard]] bool apart(Key first, Key second) const;

  /// Poses by odometry and full priors alone, in the order of the graph's nodes.
  [[nodiscard]] const std::vector<Eigen::Isometry3d>& odometry() const { return odometry_; }

 private:
  /// How well the place of a group is known.
  enum class Place {
    kGiven,  ///< By the front end alone.
    kFirst,  ///< With its robot's first node, which defines the robot's frame.
    kFixed,  ///< By a full prior or an estimate.
  };
  struct Group {
    Place place = Place::kGiven;
    std::vector<Key> nodes;
  };
  /// The neighbour that places a new node, and the step from it.
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
