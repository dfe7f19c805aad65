// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/robots.hpp>

#include <algorithm>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>

namespace loopwise {

Robot robot_of_character(char character, std::string name) {
  return {std::move(name), make_key(character, 0), make_key(character, kKeyIndexMask)};
}

Robots::Robots(std::vector<Robot> robots) : robots_(std::move(robots)) {
  std::sort(robots_.begin(), robots_.end(), [](const Robot& a, const Robot& b) { return a.first < b.first; });
  std::set<std::string> names;
  for (std::size_t i = 0; i < robots_.size(); ++i) {
    const Robot& robot = robots_[i];
    if (robot.name.empty()) throw InputError("a robot has an empty name");
    if (!names.insert(robot.name).second) throw InputError("robot \"" + robot.name + "\" is listed twice");
    if (robot.last < robot.first)
      throw InputError("robot \"" + robot.name + "\": last key is below the first");
    if (i > 0 && robots_[i - 1].last >= robot.first) {
      throw InputError("robots \"" + robots_[i - 1].name + "\" and \"" + robot.name + "\" share keys");
    }
  }
}

Robots Robots::from_keys(const std::vector<Key>& keys) {
  std::set<char> characters;
  for (const Key key : keys) characters.insert(key_character(key));
  std::vector<Robot> robots;
  for (const char character : characters) {
    // A character that is no letter gets its number as its name; so do plain integers: "0".
    const std::string name = key_name(make_key(character, 0));
    const bool letter = name.size() == 2 && name[1] == '0' && name[0] == character;
    robots.push_back(
        robot_of_character(character, letter ? std::string(1, character)
                                             : std::to_string(static_cast<unsigned char>(character))));
  }
  return Robots(std::move(robots));
}

std::optional<std::size_t> Robots::find(Key key) const {
  const auto after = std::upper_bound(robots_.begin(), robots_.end(), key,
                                      [](Key k, const Robot& robot) { return k < robot.first; });
  if (after == robots_.begin()) return std::nullopt;
  const auto robot = after - 1;
  if (key > robot->last) return std::nullopt;
  return static_cast<std::size_t>(robot - robots_.begin());
}

std::size_t Robots::of(Key key) const {
  if (const auto robot = find(key)) return *robot;
  throw UnknownKeyError("key " + std::to_string(key) + " (" + key_name(key) + ") belongs to no robot");
}

std::uint64_t Robots::node_index(Key key) const {
  return key - robots_[of(key)].first;
}

bool Robots::is_landmark(Key key) const {
  const auto robot = find(key);
  return robot && robots_[*robot].landmarks;
}

bool Robots::consecutive(Key from, Key to) const {
  if (from == ~Key{0} || to != from + 1) return false;
  const auto robot = find(from);
  return robot && robot == find(to);
}

Robots parse_robots(std::string_view text) {
  const auto fail = [](std::string_view part) -> OptionError {
    return OptionError("robots: cannot read \"" + std::string(part) +
                       "\", expected FIRST-LAST, NAME=FIRST-LAST or a letter, separated by commas");
  };
  std::vector<Robot> robots;
  while (true) {
    const std::size_t comma = text.find(',');
    const std::string_view part = text.substr(0, comma);
    std::string_view range = part;
    std::string name = std::to_string(robots.size());
    if (const std::size_t equals = part.find('='); equals != std::string_view::npos) {
      name = std::string(part.substr(0, equals));
      range = part.substr(equals + 1);
    }
    const std::size_t dash = range.find('-');
    try {
      if (dash != std::string_view::npos) {
        robots.push_back({name, parse_key(range.substr(0, dash)), parse_key(range.substr(dash + 1))});
      } else if (range.size() == 1 && key_name(make_key(range[0], 0)).front() == range[0] &&
                 !std::isdigit(range[0])) {
        robots.push_back(robot_of_character(range[0], part.size() == 1 ? std::string(part) : name));
      } else {
        throw fail(part);
      }
    } catch (const InputError&) {
      throw fail(part);
    }
    if (comma == std::string_view::npos) break;
    text.remove_prefix(comma + 1);
  }
  try {
    return Robots(std::move(robots));
  } catch (const InputError& error) {
    throw OptionError(std::string("robots: ") + error.what());
  }
}

}  // namespace loopwise
