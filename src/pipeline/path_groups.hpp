// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstddef>
#include <map>
#include <optional>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include <loopwise/core/robots.hpp>

namespace loopwise {

/// Which nodes odometry has tied to each other, whatever came first, and how surely each such group lies
/// where it does. It knows no poses. Memory and time: near linear in the nodes.
class PathGroups {
 public:
  enum class Known {
    kGiven,  ///< As the front end said.
    kFirst,  ///< With its robot's first node, by which the robot's frame is defined.
    kFixed,  ///< By a prior, or an estimate.
  };

  explicit PathGroups(Robots robots) : robots_(std::move(robots)) {}

  /// Whether the robot has a node.
  [[nodiscard]] bool has(std::size_t robot) const { return begun_.count(robot) != 0; }
  /// Of the node's group. \pre it was added
  [[nodiscard]] Known known(Key key) const { return groups_.at(group_of_.at(key)).known; }

  /// Whether one of the two may still move without the other. \pre they were added
  [[nodiscard]] bool apart(Key first, Key second) const {
    const std::size_t a = group_of_.at(first), b = group_of_.at(second);
    return a != b && (groups_.at(a).known != Known::kFixed || groups_.at(b).known != Known::kFixed);
  }

  /// A node: of the group that `member` is in, or the first of its own.
  void add(Key key, std::optional<Key> member, Known known) {
    begun_.insert(robots_.of(key));
    const std::size_t number = member ? group_of_.at(*member) : next_++;
    Group& group = groups_[number];
    if (!member) group.known = known;
    group.nodes.push_back(key);
    try {
      group_of_[key] = number;
    } catch (...) {
      group.nodes.pop_back();
      throw;
    }
  }
  /// The node that was added last was none.
  void take_back(Key key) {
    groups_.at(group_of_.at(key)).nodes.pop_back();
    group_of_.erase(key);
  }

  struct Tie {
    std::vector<Key> moved;  ///< Nodes whose place follows from the others' now; none if nobody has to move.
    bool second_moves = false;  ///< They are those of the second node.
  };
  /// Makes one of the two nodes' groups. Who knows less of its place moves, and of two alike the smaller; two
  /// that are fixed stay.
  [[nodiscard]] Tie tie(Key first, Key second) {
    std::size_t a = group_of_.at(first), b = group_of_.at(second);
    Tie tie;
    if (a == b) return tie;
    const auto rank = [this](std::size_t group) {
      return std::pair(groups_.at(group).known, groups_.at(group).nodes.size());
    };
    tie.second_moves = rank(b) <= rank(a);
    if (!tie.second_moves) std::swap(a, b);  // b comes to a
    if (groups_.at(b).known != Known::kFixed) tie.moved = groups_.at(b).nodes;
    const Known known = groups_.at(a).known;
    if (groups_.at(a).nodes.size() < groups_.at(b).nodes.size())
      std::swap(a, b);  // names are changed of the fewer
    Group& into = groups_.at(a);
    const std::size_t needed = into.nodes.size() + groups_.at(b).nodes.size();
    // From here on nothing asks for memory.
    if (needed > into.nodes.capacity()) into.nodes.reserve(std::max(needed, 2 * into.nodes.capacity()));
    for (const Key key : groups_.at(b).nodes) {
      group_of_[key] = a;
      into.nodes.push_back(key);
    }
    into.known = known;
    groups_.erase(b);
    return tie;
  }

  /// The node's place is known. \returns its group if that was not fixed before
  [[nodiscard]] std::vector<Key> fix(Key key) {
    Group& group = groups_.at(group_of_.at(key));
    if (group.known == Known::kFixed) return {};
    std::vector<Key> nodes = group.nodes;
    group.known = Known::kFixed;
    return nodes;
  }

 private:
  struct Group {
    Known known = Known::kGiven;
    std::vector<Key> nodes;
  };
  Robots robots_;
  std::unordered_set<std::size_t> begun_;
  std::unordered_map<Key, std::size_t> group_of_;
  std::map<std::size_t, Group> groups_;
  std::size_t next_ = 0;
};

}  // namespace loopwise
