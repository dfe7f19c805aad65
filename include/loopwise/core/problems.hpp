// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// A kind of tolerable flaw in the input, with its count and the place of the first one.
struct Problem {
  std::string kind;       ///< Short and stable, for example "non-unit quaternion".
  std::string example;    ///< The first occurrence, with file and line or key.
  std::size_t count = 0;  ///< Number of occurrences.
  bool altered = false;   ///< The result differs from the file, see Problems::add_altered().
};

/// Counts warnings of a reader, so that the library drops nothing silently. The library prints nothing.
class LOOPWISE_EXPORT Problems {
 public:
  /// Counts a flaw of this kind. The first example is kept.
  void add(const std::string& kind, const std::string& example, std::size_t count = 1);
  /// Counts a flaw for which a measurement was repaired, guessed or left out.
  void add_altered(const std::string& kind, const std::string& example, std::size_t count = 1);
  /// Adds the problems of another reader.
  void add(const Problems& others);

  /// Number of occurrences of this kind.
  [[nodiscard]] std::size_t count(const std::string& kind) const;
  /// Whether there was no flaw.
  [[nodiscard]] bool empty() const { return all_.empty(); }
  /// In the order of first occurrence.
  [[nodiscard]] const std::vector<Problem>& all() const { return all_; }

 private:
  std::vector<Problem> all_;
};

/// One line per problem: "non-unit quaternion (3 times, first: run.g2o:41)".
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const Problem& problem);

/// Refuses measurements that were repaired, guessed or left out. \throws InputError naming the first problem
/// that is `altered`
LOOPWISE_EXPORT void require_unaltered(const Problems& problems);

}  // namespace loopwise
