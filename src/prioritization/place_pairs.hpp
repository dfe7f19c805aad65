// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/id_table.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise::detail {

/// Divides the paths of robots into places, i.e. sections of consecutive nodes.
class Places {
 public:
  Places(Robots robots, double place_m) : robots_(std::move(robots)), place_m_(place_m) {}

  /// Assigns places to the new nodes of the graph, by their present poses. \pre nodes keep their numbers
  void add_nodes(const PoseGraph& graph);

  [[nodiscard]] std::size_t nodes() const { return place_.size(); }
  [[nodiscard]] std::uint32_t place_of(std::size_t node) const { return place_[node]; }
  [[nodiscard]] std::size_t robot_of(std::size_t node) const { return robot_[node]; }
  /// The robot's node before this one, or the node itself.
  [[nodiscard]] std::uint32_t before(std::size_t node) const { return before_[node]; }

 private:
  struct End {
    std::uint32_t place, node;
    Eigen::Vector3d position;
    double length_m;  ///< Of the place so far.
  };
  Robots robots_;
  double place_m_;
  std::uint32_t next_place_ = 0;
  std::vector<std::uint32_t> place_, before_;
  std::vector<std::size_t> robot_;
  std::unordered_map<std::size_t, End> ends_;  // of the path so far, by robot
};

/// Numbers unordered pairs of places. Each place has a row that is contiguous in memory. Candidates arrive
/// node by node, so most of them find the row in the cache.
class PlacePairs {
 public:
  /// The number of a pair. A new pair gets the number size().
  std::uint32_t number_of(std::uint32_t a, std::uint32_t b);
  /// Null if the pair has no number.
  [[nodiscard]] const std::uint32_t* find(std::uint32_t a, std::uint32_t b) const;
  /// Number of numbered pairs.
  [[nodiscard]] std::uint32_t size() const { return size_; }

 private:
  using Row = std::vector<std::pair<std::uint32_t, std::uint32_t>>;  // the smaller place, the pair's number
  std::vector<Row> rows_;  // by the larger place, in the order of the smaller one
  std::uint32_t size_ = 0;
};

/// A candidate as a member of its group.
struct GroupMember {
  LoopCandidate candidate;
  std::uint32_t from = 0, to = 0;  ///< Nodes of the graph.
  float overlap = -1.0F;           ///< Prediction at the group's last evaluation; < 0: none yet.
};

}  // namespace loopwise::detail
