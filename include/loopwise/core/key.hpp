// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Node id. The top 8 bits hold a robot character, the low 56 bits the index of the node. This is the layout
/// of gtsam::Symbol, so files of GTSAM and LAMP can be read unchanged. Plain integers (character 0) are valid
/// keys. If both the top 8 bits and the next 8 bits are ASCII letters, the key is a gtsam::LabeledSymbol: a
/// character, a label that identifies the robot, as in Swarm-SLAM, and an index of 48 bits. A Symbol looks
/// like one only if its index exceeds 1.8e16. Keys exceed 2^53: never store one in a double.
using Key = std::uint64_t;

inline constexpr int kKeyIndexBits = 56;  ///< Low bits of a key that hold the index.
inline constexpr Key kKeyIndexMask = (Key{1} << kKeyIndexBits) - 1;  ///< Mask of the index.

/// Key of node `index` of the robot with this character; character 0 gives the plain integer.
[[nodiscard]] constexpr Key make_key(char character, std::uint64_t index) {
  return (static_cast<Key>(static_cast<unsigned char>(character)) << kKeyIndexBits) | (index & kKeyIndexMask);
}

/// The robot character of a key; 0 of a plain integer.
[[nodiscard]] constexpr char key_character(Key key) {
  return static_cast<char>(key >> kKeyIndexBits);
}
/// The index of a key, without the robot character.
[[nodiscard]] constexpr std::uint64_t key_index(Key key) {
  return key & kKeyIndexMask;
}

inline constexpr int kKeyLabelShift = 48;  ///< Low bits of a labelled key that hold the index.

/// The label of a gtsam::LabeledSymbol, a letter; 0 if the key has no label.
[[nodiscard]] LOOPWISE_EXPORT char key_label(Key key);

/// Name of a key for messages: "a12" if the character is a letter, "gB12" if the key also has a label,
/// otherwise the plain number. Files contain the number.
[[nodiscard]] LOOPWISE_EXPORT std::string key_name(Key key);

/// Reads a decimal number of up to 64 bits, or one or two letters followed by an index ("a12", "gB12").
/// \throws InputError naming the text if it has another form.
[[nodiscard]] LOOPWISE_EXPORT Key parse_key(std::string_view text);

}  // namespace loopwise
