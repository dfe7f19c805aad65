// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Gathers a mission from messages of LAMP and of data sets that were recorded with it. Private to io.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "mission_parts.hpp"
#include "ros_message.hpp"

namespace loopwise::lamp {

enum class MessageKind {
  kOther,
  kKeyedScan,  ///< pose_graph_msgs/KeyedScan
  kPoseGraph,  ///< pose_graph_msgs/PoseGraph
  kBeacons,    ///< pose_graph_msgs/CommNodeStatus
  kRadio,      ///< silvus_msgs/SilvusStreamscape
  kOdometry,   ///< nav_msgs/Odometry
};
[[nodiscard]] MessageKind message_kind(const std::string& type);

/// The pose of a position and an orientation; empty if it is not finite or was never set.
[[nodiscard]] std::optional<Eigen::Isometry3d> pose_of(const ros1::Value& position,
                                                       const ros1::Value& orientation);
[[nodiscard]] std::optional<Eigen::Isometry3d> pose_of(const ros1::Value& pose);
/// The same for nav_msgs/Odometry, geometry_msgs/PoseStamped or geometry_msgs/PoseWithCovarianceStamped.
[[nodiscard]] std::optional<Eigen::Isometry3d> pose_of_message(const ros1::Value& message);

/// The stamp of a message's header, or `otherwise` if that is 0.
[[nodiscard]] std::int64_t stamp_of(const ros1::Value& message, std::int64_t otherwise);

/// A node as in the first message with a usable pose of it.
struct SeenNode {
  std::optional<Eigen::Isometry3d> pose;
  std::int64_t stamp_ns = 0;  ///< Of the node, or of the recording if no message has one.
  bool has_stamp = false;
  std::string where;
};

/// Any factor between two nodes or of one (from = to).
struct SeenFactor {
  Key from = 0;
  Key to = 0;
  std::optional<Eigen::Isometry3d> pose;  ///< T_from_to, or the pose of a prior. Empty if not set.
  std::array<double, 36> covariance{};    ///< As in the message.
  std::optional<Matrix6d> information;    ///< Empty if that is all zero, or cannot be inverted.
  std::string where;
};

struct SeenRange {
  Key from = 0;
  Key to = 0;
  double range_m = 0.0;
  double sigma_m = 0.0;  ///< 0 if the message does not state it.
  std::string where;
};

struct SeenGravity {
  Key key = 0;
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  ///< Body frame.
  double sigma_rad = 0.0;                               ///< 0 if the message does not state it.
  std::string where;
};

/// All graphs of a recording as one, in the order of arrival.
struct SeenGraph {
  std::map<Key, SeenNode> nodes;      ///< Key frames of robots.
  std::map<Key, SeenNode> landmarks;  ///< Artifacts and radio anchors.
  std::vector<SeenFactor> priors;
  std::vector<SeenFactor> odometry;
  std::vector<SeenFactor> closures;
  std::vector<SeenFactor> sightings;  ///< Artifacts and radio anchors by their poses.
  std::vector<SeenRange> ranges;
  std::vector<SeenGravity> gravities;
};

/// Whether LAMP gives such keys to landmarks.
[[nodiscard]] bool is_landmark(Key key);

/// The first word of a topic, which names its robot; empty if the topic has only one word.
[[nodiscard]] std::string first_word(const std::string& topic);

/// Collects messages in any order. A scan may come before its node, and repeated messages count once.
class Gatherer {
 public:
  Gatherer(const MissionOptions& options, Problems& problems);

  /// `where` stands for the topic and its bag in problems. \throws InputError if the message lacks a field.
  void add_graph(const std::string& where, const std::string& topic, std::int64_t recorded_ns,
                 const ros1::Value& message);
  void add_beacons(const ros1::Value& message, std::int64_t recorded_ns);
  void add_radio(const ros1::Value& message, std::int64_t recorded_ns);
  /// Adds a true pose. `source` is the topic and the name of the bag, which may begin with the robot's name.
  void add_truth(const std::vector<std::string>& source, const ros1::Value& message,
                 std::int64_t recorded_ns);

  /// Sets stamps of nodes whose messages had no stamp.
  void use_stamps(const parts::Stamps& stamps);

  [[nodiscard]] const SeenGraph& graph() const { return graph_; }

  /// Fills robots, graph, radio, beacons and ground truth of the mission. \throws InputError if there is no
  /// node
  void finish(Mission& mission, const std::string& name) const;
  /// Assigns the true poses to the nodes of a mission from another source.
  void add_truth_to(Mission& mission) const;

 private:
  /// The landmarks that factors constrain.
  struct Landmarks {
    std::map<Key, Eigen::Isometry3d> poses;
    std::vector<Key> by_ranges;  ///< Constrained only by ranges; these need a prior.
  };
  struct Drop {
    std::string beacon;
    Key key = 0;
    std::int64_t stamp_ns = 0;
  };
  struct Reading {
    std::int64_t stamp_ns = 0;
    std::string robot;
    std::string beacon;
    double transmit_dbm = 0.0;
    std::vector<double> receive_dbm;
  };
  struct Truth {
    std::vector<std::string> source;
    std::vector<std::pair<std::int64_t, Eigen::Isometry3d>> poses;
  };

  void add_node(const std::string& where, const ros1::Value& node, std::int64_t recorded_ns);
  void add_factor(const std::string& where, const ros1::Value& edge);
  [[nodiscard]] std::optional<Matrix6d> information(const SeenFactor& seen, bool translation_first,
                                                    bool check_order);
  [[nodiscard]] std::map<char, std::string> robot_names() const;
  [[nodiscard]] Landmarks held_landmarks(const PoseGraph& key_frames) const;
  void add_factors(Mission& mission, const std::string& name, const Landmarks& landmarks) const;
  void add_ranges(PoseGraph& graph) const;
  void add_gravity(PoseGraph& graph) const;
  [[nodiscard]] parts::Stamps stamps_of(const PoseGraph& graph, const Robots& robots) const;
  void add_radio_to(Mission& mission) const;
  [[nodiscard]] std::optional<std::size_t> robot_named(const Robots& robots, const std::string& text) const;
  [[nodiscard]] std::optional<std::size_t> robot_of_truth(const Robots& robots, const Truth& truth) const;

  const MissionOptions& options_;
  Problems& problems_;
  SeenGraph graph_;
  /// Type, from, to -> number in its list of graph_.
  std::map<std::tuple<std::int64_t, Key, Key>, std::size_t> known_;
  std::map<std::string, std::set<char>> characters_;  ///< First word of a topic -> characters of its nodes.
  std::map<std::string, Drop> drops_;
  std::vector<Reading> readings_;
  std::vector<Truth> truths_;
};

}  // namespace loopwise::lamp
