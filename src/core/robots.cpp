// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/robots.hpp>

#include <algorithm>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>

#include "letters.hpp"

namespace loopwise {
namespace {

/// The robot whose keys have this character and this label below it.
Robot robot_of_label(char character, unsigned char label, std::string name) {
  const Key first = make_key(character, Key{label} << kKeyLabelShift);
  return {std::move(name), first, first | ((Key{1} << kKeyLabelShift) - 1)};
}

}  // namespace

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
  std::map<char, std::set<unsigned char>> labels;  // by character
  std::set<char> labelled;
  for (const Key key : keys) {
    labels[key_character(key)].insert(static_cast<unsigned char>(key >> kKeyLabelShift));
    if (key_label(key) != '\0') labelled.insert(key_character(key));
  }
  std::vector<Robot> robots;
  for (const auto& [character, of_character] : labels) {
    // A character that is not a letter is named by its number. Plain integer keys get the name "0".
    const bool letter = detail::is_letter(character);
    const std::string name =
        letter ? std::string(1, character) : std::to_string(static_cast<unsigned char>(character));
    if (labelled.count(character) == 0) {
      robots.push_back(robot_of_character(character, name));
      continue;
    }
    for (const unsigned char label : of_character) {
      const std::string suffix = label == 0 ? ""
                                 : detail::is_letter(static_cast<char>(label))
                                     ? std::string(1, static_cast<char>(label))
                                     : std::to_string(label);
      robots.push_back(robot_of_label(character, label, name + suffix));
    }
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

Robots parse_robots(std::string_view text) {
  const auto fail = [](std::string_view part) -> OptionError {
    return OptionError(
        "robots: cannot read \"" + std::string(part) +
        "\", expected FIRST-LAST, NAME=FIRST-LAST, or one or two letters, separated by commas");
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
      } else if (range.size() == 1 && detail::is_letter(range[0])) {
        robots.push_back(robot_of_character(range[0], part.size() == 1 ? std::string(part) : name));
      } else if (range.size() == 2 && detail::is_letter(range[0]) && detail::is_letter(range[1])) {
        robots.push_back(robot_of_label(range[0], static_cast<unsigned char>(range[1]),
                                        part.size() == 2 ? std::string(part) : name));
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
