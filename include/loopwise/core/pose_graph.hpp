// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// A key frame: pose of the body in the common frame, p_world = pose · p_body.
struct Node {
  Key key = 0;  ///< Unique in its graph.
  /// T_world_body, the current estimate; translation in metres.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  std::int64_t stamp_ns = 0;  ///< Of its scan, ns since the epoch of the recording.
  /// Marginal covariance, right perturbation [translation, rotation], if the back end computed it.
  std::optional<Matrix6d> covariance;
};

/// Prior knowledge of one node's pose: r = Log(pose⁻¹ · T_node), cost ½ rᵀΩr.
struct PriorFactor {
  Key key = 0;  ///< The constrained node.
  /// T_world_body, the expected pose.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Matrix6d information = Matrix6d::Identity();  ///< Ω, order [translation, rotation], 1/m² and 1/rad².
};

/// A measured distance between the origins of two nodes, for example by ultra-wideband radios:
/// r = (‖t_to − t_from‖ − range_m) / sigma_m, cost ½ r².
struct RangeFactor {
  Key from = 0;          ///< One of the two nodes.
  Key to = 0;            ///< The other.
  double range_m = 0.0;  ///< As measured.
  double sigma_m = 1.0;  ///< Standard deviation.
};

/// The direction of gravity, measured by an accelerometer at rest. With R the node's rotation
/// r = (R · direction − reference) / sigma_rad, cost ½ ‖r‖²; ‖R · direction − reference‖ = 2 sin(θ/2) for an
/// angle θ between the two. Carries no information on yaw and position.
struct GravityFactor {
  Key key = 0;                                            ///< The node of the measurement.
  Eigen::Vector3d direction = -Eigen::Vector3d::UnitZ();  ///< Body frame; any length but 0.
  double sigma_rad = 1.0;                                 ///< Standard deviation.
  Eigen::Vector3d reference = -Eigen::Vector3d::UnitZ();  ///< Common frame; any length but 0.
};

/// The origin of an edge. It decides whether robust optimisation may reject the edge.
enum class EdgeKind {
  kOdometry,     ///< Between consecutive nodes on one robot's path: never rejected.
  kLoopClosure,  ///< All other edges between key frames.
  kLandmark,     ///< From a key frame to a landmark that it saw. Robust optimisation may reject it.
};

/// A measured relative pose from a front end or a place recognition. See Edge for the residual.
struct BetweenFactor {
  Key from = 0;  ///< Node whose frame the measurement is given in.
  Key to = 0;    ///< Node that was measured.
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();  ///< Pose of `to` in the frame of `from`.
  /// Ω, order [translation, rotation], symmetric, not indefinite.
  Matrix6d information = Matrix6d::Identity();
  bool trusted = false;  ///< A known inlier: robust optimisation keeps its weight at 1. Odometry always is.
};

/// A measured relative pose in a graph: r = Log(T_from_to⁻¹ · T_from⁻¹ · T_to), cost ½·weight·rᵀΩr.
struct Edge {
  Key from = 0;  ///< Node whose frame the measurement is given in.
  Key to = 0;    ///< Node that was measured.
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();  ///< Pose of `to` in the frame of `from`.
  /// Ω, order [translation, rotation], symmetric, not indefinite.
  Matrix6d information = Matrix6d::Identity();
  EdgeKind kind = EdgeKind::kLoopClosure;  ///< Odometry or closure.
  bool trusted = false;  ///< A known inlier: robust optimisation keeps its weight at 1. Odometry always is.
  double weight = 1.0;   ///< Of the last robust optimisation, in [0, 1].
};

/// Poses and the measurements between them. Grows cheaply and keeps its invariants: keys are unique, the
/// nodes of every factor exist, poses and information are finite, information is symmetric and not
/// indefinite. Nodes and edges are numbered in the order of arrival, and solvers use these numbers.
///
/// A planar graph is in the plane z = 0, as for robots on wheels with 2D lidars: z, roll and pitch of poses
/// and measurements are 0, covariances are zero there, and tests of chi-squared use three degrees of freedom.
/// Only information on x, y and the rotation about z counts (see planar::information()).
class LOOPWISE_EXPORT PoseGraph {
 public:
  /// Declares the graph planar or not planar. In a planar graph, a pose with z, roll or pitch, information
  /// that couples these to the plane, and gravity are errors. \throws InputError naming the part of the graph
  /// outside the plane.
  void set_planar(bool planar = true);
  /// Whether the graph is planar.
  [[nodiscard]] bool planar() const { return planar_; }
  /// Degrees of freedom of a relative pose: 3 in a planar graph, otherwise 6.
  [[nodiscard]] int degrees_of_freedom() const { return planar_ ? 3 : 6; }

  /// \returns its number. \throws InputError on a repeated key or a pose that is not finite.
  std::size_t add_node(const Node& node);
  /// \throws UnknownKeyError; InputError on bad numbers (see check_information).
  std::size_t add_prior(const PriorFactor& prior);
  /// \throws UnknownKeyError; InputError on bad numbers or an edge from a node to itself.
  std::size_t add_edge(const Edge& edge);
  /// \throws UnknownKeyError; InputError on a negative range, a sigma that is not positive, or a range from a
  /// node to itself.
  std::size_t add_range(const RangeFactor& range);
  /// Makes both directions unit vectors. \throws UnknownKeyError; InputError on a direction of length 0 or a
  /// sigma that is not positive.
  std::size_t add_gravity(const GravityFactor& gravity);
  /// Adds the edge of a verified closure. Its information is the inverse of the closure's covariance. \throws
  /// UnknownKeyError; InputError on bad numbers or a covariance that is not positive definite.
  std::size_t add_closure(const LoopClosure& closure);
  /// Removes the edges for which `drop(edge)` is true; the others keep their order. \returns the number of
  /// removed edges.
  template <class Predicate>
  std::size_t remove_edges_if(Predicate&& drop) {
    std::vector<Edge> kept;
    kept.reserve(edges_.size());
    for (const Edge& edge : edges_) {
      if (!drop(edge)) kept.push_back(edge);
    }
    return replace_edges(std::move(kept));
  }

  /// Whether the key has a node.
  [[nodiscard]] bool contains(Key key) const { return index_.count(key) != 0; }
  /// Number of the key's node, if it exists.
  [[nodiscard]] std::optional<std::size_t> find(Key key) const;
  /// \throws UnknownKeyError
  [[nodiscard]] std::size_t index_of(Key key) const;
  /// \throws UnknownKeyError
  [[nodiscard]] const Node& node(Key key) const { return nodes_[index_of(key)]; }

  /// In the order of arrival, which defines their numbers.
  [[nodiscard]] const std::vector<Node>& nodes() const { return nodes_; }
  /// In order of arrival.
  [[nodiscard]] const std::vector<PriorFactor>& priors() const { return priors_; }
  /// In the order of arrival, which defines their numbers.
  [[nodiscard]] const std::vector<Edge>& edges() const { return edges_; }
  /// In order of arrival.
  [[nodiscard]] const std::vector<RangeFactor>& ranges() const { return ranges_; }
  /// In order of arrival.
  [[nodiscard]] const std::vector<GravityFactor>& gravities() const { return gravities_; }
  /// Whether there is no node.
  [[nodiscard]] bool empty() const { return nodes_.empty(); }
  /// Keys of all nodes by their number.
  [[nodiscard]] std::vector<Key> keys() const;

  /// Node numbers of an edge's two ends.
  struct Ends {
    std::size_t from;  ///< Number of Edge::from.
    std::size_t to;    ///< Number of Edge::to.
  };
  /// Numbers of the two nodes that edge number `edge` joins. \throws InputError if there is no such edge.
  [[nodiscard]] Ends ends(std::size_t edge) const {
    if (edge >= ends_.size()) refuse_number("edge", edge, ends_.size());
    return ends_[edge];
  }
  /// Numbers of the edges at a node, in order of arrival. \throws InputError if there is no such node.
  [[nodiscard]] const std::vector<std::size_t>& edges_of(std::size_t node) const {
    if (node >= adjacency_.size()) refuse_number("node", node, adjacency_.size());
    return adjacency_[node];
  }

  /// \throws UnknownKeyError; InputError if the pose is not finite.
  void set_pose(Key key, const Eigen::Isometry3d& pose);
  /// One pose per node, by number. \throws InputError on another count or a pose that is not finite.
  void set_poses(const std::vector<Eigen::Isometry3d>& poses);
  /// Poses of all nodes by their number.
  [[nodiscard]] std::vector<Eigen::Isometry3d> poses() const;
  /// Sets or clears a marginal covariance. \throws InputError if it is not finite, or without such a node.
  void set_covariance(std::size_t node, const std::optional<Matrix6d>& covariance);
  /// \throws InputError if there is no such edge or the weight is outside [0, 1].
  void set_weight(std::size_t edge, double weight);
  /// Sets whether an edge is a known inlier, which robust optimisation keeps. \throws InputError without such
  /// an edge.
  void set_trusted(std::size_t edge, bool trusted);
  /// \throws InputError if there is no such edge, or on bad numbers (see check_information).
  void set_information(std::size_t edge, const Matrix6d& information);
  /// Sets the kind of an edge. \throws InputError if there is no such edge.
  void set_kind(std::size_t edge, EdgeKind kind);

 private:
  [[noreturn]] static void refuse_number(const char* what, std::size_t number, std::size_t count);
  [[nodiscard]] Edge& edge_at(std::size_t number);
  std::size_t replace_edges(std::vector<Edge> edges);
  [[nodiscard]] bool fits(const Eigen::Isometry3d& pose) const;
  void require_pose(const Eigen::Isometry3d& pose, const std::string& what) const;
  void require_information(const Matrix6d& information, const std::string& what) const;

  bool planar_ = false;
  std::vector<Node> nodes_;
  std::vector<PriorFactor> priors_;
  std::vector<Edge> edges_;
  std::vector<RangeFactor> ranges_;
  std::vector<GravityFactor> gravities_;
  std::vector<Ends> ends_;
  std::vector<std::vector<std::size_t>> adjacency_;
  std::unordered_map<Key, std::size_t> index_;
};

/// Connected components by edges; ranges do not connect components. \returns for each node the number of its
/// component, from 0 in node order.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::size_t> connected_components(const PoseGraph& graph);

/// Keys of each robot's nodes in ascending order, which is the order of its path. Landmarks and nodes without
/// a robot are left out.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::vector<Key>> robot_paths(const PoseGraph& graph,
                                                                        const Robots& robots);

/// Pairs of consecutive nodes on a robot's path. No node of the robot is between them, and their keys differ
/// by less than 2^47.
class LOOPWISE_EXPORT Neighbours {
 public:
  /// Uses the current nodes of the graph.
  Neighbours(const PoseGraph& graph, const Robots& robots);

  /// Whether the two nodes are consecutive.
  [[nodiscard]] bool operator()(Key a, Key b) const;

 private:
  std::unordered_map<Key, Key> next_;
};

/// The inverse measurement, with its information.
[[nodiscard]] LOOPWISE_EXPORT Edge reversed(const Edge& edge);

/// Pairs of keys. The order within a pair does not matter.
using KeyPairs = std::set<std::pair<Key, Key>>;

/// Sets the kind of every edge. Edges between neighbours of one robot, in either direction, are odometry.
/// Edges to a landmark are sightings, and all others are loop closures. If several edges join the same
/// neighbours, those that contradict the odometry (beyond quantile 0.9999 of chi-squared) become loop
/// closures, which robust optimisation may reject. Edges that fit the nodes' poses are tried first, then the
/// others in their order. An edge is odometry if it agrees with all odometry edges before it. \returns
/// problems with the place of the first: "edge that contradicts the odometry, treated as a loop closure",
/// "odometry chain broken", "robot whose keys have a jump of 2^47 or more".
LOOPWISE_EXPORT Problems classify_edges(PoseGraph& graph, const Robots& robots);
/// The same, with odometry defined by these pairs. \throws InputError naming a pair without an edge or with a
/// landmark.
LOOPWISE_EXPORT Problems classify_edges(PoseGraph& graph, const Robots& robots, const KeyPairs& odometry);

/// The reason why an information matrix cannot be used ("not finite", "not symmetric", "indefinite"), or null
/// if it can be used. Positive semi-definite matrices pass, with a tolerance of 1e-9 of the largest element.
[[nodiscard]] LOOPWISE_EXPORT const char* check_information(const Matrix6d& information);

}  // namespace loopwise
