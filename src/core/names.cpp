// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/names.hpp>

#include <algorithm>
#include <numeric>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

/// Longer names are not misspellings of a known one, and the comparison takes longer for them.
constexpr std::size_t kLongestGuessed = 200;

/// Levenshtein's distance.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i + 1;
    for (std::size_t j = 0; j < b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i] == b[j] ? 0 : 1);
      diagonal = row[j + 1];
      row[j + 1] = std::min({replaced, row[j] + 1, diagonal + 1});
    }
  }
  return row.back();
}

}  // namespace

void throw_unknown_name(std::string_view what, std::string_view name, const std::vector<std::string>& known) {
  const std::string* nearest = nullptr;
  std::size_t least = std::max<std::size_t>(2, name.size() / 3) + 1;
  for (const std::string& candidate : known) {
    if (name.size() > kLongestGuessed) break;
    const std::size_t distance = edit_distance(name, candidate);
    if (distance < least) {
      least = distance;
      nearest = &candidate;
    }
  }
  std::string message = "unknown " + std::string(what) + " " + std::string(name);
  if (nearest != nullptr) message += ", did you mean " + *nearest + "?";
  message += nearest != nullptr ? " Known: " : "; known: ";
  for (std::size_t i = 0; i < known.size(); ++i) message += (i > 0 ? ", " : "") + known[i];
  throw OptionError(message);
}

}  // namespace loopwise
