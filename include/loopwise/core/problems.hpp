// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// One kind of flaw that a reader met and could live with, how often, and where it first stood.
struct Problem {
  std::string kind;       ///< Short and stable, for example "non-unit quaternion".
  std::string example;    ///< The first occurrence, with file and line or key.
  std::size_t count = 0;  ///< How often it was met.
  bool altered = false;   ///< What was read differs from what the file says, see Problems::add_altered().
};

/// Counted warnings of a reader: nothing is printed by the library and nothing is lost silently.
class LOOPWISE_EXPORT Problems {
 public:
  /// Counts a flaw of this kind; the example stays that of the first.
  void add(const std::string& kind, const std::string& example, std::size_t count = 1);
  /// The same of a flaw for which a measurement was repaired, guessed or left out.
  void add_altered(const std::string& kind, const std::string& example, std::size_t count = 1);
  /// Counts all that another reader met.
  void add(const Problems& others);

  /// How often this kind was met; 0 if never.
  [[nodiscard]] std::size_t count(const std::string& kind) const;
  /// Whether there was no flaw.
  [[nodiscard]] bool empty() const { return all_.empty(); }
  /// In the order of first occurrence.
  [[nodiscard]] const std::vector<Problem>& all() const { return all_; }

 private:
  std::vector<Problem> all_;
};

/// One line a problem: "non-unit quaternion (3 times, first: run.g2o:41)".
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const Problem& problem);

/// For those who want no measurement repaired, guessed or left out. \throws InputError naming the first
/// problem that is `altered`
LOOPWISE_EXPORT void require_unaltered(const Problems& problems);

}  // namespace loopwise
