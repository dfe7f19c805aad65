// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>

namespace loopwise {

/// A robot of the team with the range of keys of its nodes.
struct Robot {
  std::string name;  ///< Unique in the team, not empty.
  Key first = 0;     ///< Least key of its nodes.
  Key last = 0;      ///< Largest key of its nodes; part of the range.
  /// The nodes are landmarks (artifacts, radio anchors) that robots saw, not key frames. They take part in
  /// the optimisation, have no scans and no odometry, and are never candidates.
  bool landmarks = false;
};

/// The robot whose keys have this character.
[[nodiscard]] LOOPWISE_EXPORT Robot robot_of_character(char character, std::string name);

/// Assigns keys to robots. Robots are numbered from 0 in the order of their key ranges.
class LOOPWISE_EXPORT Robots {
 public:
  Robots() = default;

  /// \throws InputError on an empty or repeated name, a range with last < first, or overlapping ranges.
  explicit Robots(std::vector<Robot> robots);

  /// One robot per character, named after it. All plain integers together form the robot "0". If the keys of
  /// a character have labels, see Key, each of its labels is a robot: "gA", "gB".
  [[nodiscard]] static Robots from_keys(const std::vector<Key>& keys);

  /// Number of robots.
  [[nodiscard]] std::size_t size() const { return robots_.size(); }
  /// Whether there is no robot.
  [[nodiscard]] bool empty() const { return robots_.empty(); }
  /// The robot of this number. \pre robot < size()
  [[nodiscard]] const Robot& operator[](std::size_t robot) const { return robots_[robot]; }
  /// By number.
  [[nodiscard]] const std::vector<Robot>& all() const { return robots_; }

  /// The robot that owns the key, if any.
  [[nodiscard]] std::optional<std::size_t> find(Key key) const;

  /// \throws UnknownKeyError if no robot owns the key.
  [[nodiscard]] std::size_t of(Key key) const;

  /// Index of the node among the nodes of its robot, from 0. \throws UnknownKeyError if no robot owns the
  /// key.
  [[nodiscard]] std::uint64_t node_index(Key key) const;

  /// True if the key's owner is a group of landmarks.
  [[nodiscard]] bool is_landmark(Key key) const;

 private:
  std::vector<Robot> robots_;  // sorted by first
};

/// Reads "0-624,625-1249" (robots named "0", "1", ...) or "husky=0-624,spot=625-1249" or "a,b" (characters)
/// or "gA,gB" (characters with labels).
/// \throws OptionError naming the part that cannot be read.
[[nodiscard]] LOOPWISE_EXPORT Robots parse_robots(std::string_view text);

}  // namespace loopwise
