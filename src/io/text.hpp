// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Reading and writing numbers and lines without locale, streams or copies. Private to io.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include <Eigen/Geometry>

namespace loopwise::text {

[[nodiscard]] constexpr bool is_blank(char c) {
  return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
}

/// The text without blanks at its ends.
[[nodiscard]] std::string_view trim(std::string_view text);

/// At most 40 characters in quotes. Unprintable characters become '?', so that an error about a binary file
/// is readable.
[[nodiscard]] std::string quoted(std::string_view text);

/// Whether the text is valid UTF-8.
[[nodiscard]] bool is_utf8(std::string_view text);

/// The text as UTF-8. Each invalid byte becomes '%' and two digits, as in an address. JSON and XML would
/// replace all invalid texts by the same character.
[[nodiscard]] std::string legible(std::string_view text);

/// Iterates over the lines of a text, numbered from 1. Skips a byte order mark.
class Lines {
 public:
  explicit Lines(std::string_view all);
  /// Gets the next line. False at the end.
  [[nodiscard]] bool next(std::string_view& line);
  [[nodiscard]] std::size_t number() const { return number_; }
  /// Whether the last line had a line end.
  [[nodiscard]] bool ended() const { return ended_; }
  /// The text after the last line.
  [[nodiscard]] std::string_view rest() const { return rest_; }

 private:
  std::string_view rest_;
  std::size_t number_ = 0;
  bool ended_ = true;
};

/// Takes the next word from the front of the line; empty at its end or before a comment ('#').
[[nodiscard]] inline std::string_view next_word(std::string_view& line) {
  std::size_t begin = 0;
  while (begin < line.size() && is_blank(line[begin])) ++begin;
  if (begin == line.size() || line[begin] == '#') {
    line = {};
    return {};
  }
  std::size_t end = begin;
  while (end < line.size() && !is_blank(line[end])) ++end;
  const std::string_view word = line.substr(begin, end - begin);
  line.remove_prefix(end);
  return word;
}

enum class Number { kOk, kNotANumber, kNotFinite };
[[nodiscard]] Number parse_double(std::string_view word, double& value);

/// The reason why the word is not an id of 64 bits, or null if it is one.
[[nodiscard]] const char* parse_id(std::string_view word, std::uint64_t& value);
[[nodiscard]] bool parse_int64(std::string_view word, std::int64_t& value);

/// Converts decimal seconds to nanoseconds, exactly for up to nine decimals: a double would lose the last
/// 100 ns. Empty if the word is not a number or beyond ±9.2e9 s.
[[nodiscard]] std::optional<std::int64_t> parse_seconds_ns(std::string_view word);

/// Position in a file, for errors.
struct Place {
  const std::string& file;
  std::size_t line;

  [[nodiscard]] std::string str() const { return file + ":" + std::to_string(line); }
  /// \throws ParseError
  [[noreturn]] void fail(const std::string& why) const;
};

/// Reads up to `capacity` numbers from the line. \returns the number of words in the line, which may be
/// larger. \throws ParseError on a word that is no finite number
[[nodiscard]] std::size_t read_numbers(std::string_view& line, double* values, std::size_t capacity,
                                       const Place& place);

struct Pose {
  Eigen::Isometry3d pose;
  bool was_unit;  ///< The quaternion's norm was 1 to within 1e-3.
};
/// Converts x y z qx qy qz qw. \throws ParseError on a zero quaternion.
[[nodiscard]] Pose pose_of(const double* values, const Place& place);

struct Rigid {
  Eigen::Isometry3d pose;
  bool was_rotation;  ///< The 3×3 part was orthonormal to within 1e-3.
};
/// Converts a row-major 3×4 matrix and replaces its 3×3 part by the nearest rotation. \throws ParseError if
/// the part differs from a rotation by more than 0.1.
[[nodiscard]] Rigid rigid_of(const double* values, const Place& place);

/// The shortest digits that read back to the same bits.
void append(std::string& out, double value);
void append(std::string& out, float value);
void append(std::string& out, std::uint64_t value);
/// "x y z qx qy qz qw", qw ≥ 0.
void append_pose(std::string& out, const Eigen::Isometry3d& pose, char separator = ' ');

/// Whether the text is not empty and has no other characters than digits.
[[nodiscard]] bool has_only_digits(std::string_view text);

}  // namespace loopwise::text
