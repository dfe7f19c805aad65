// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/problems.hpp>

#include <algorithm>

#include <loopwise/core/error.hpp>

namespace loopwise {

void Problems::add(const std::string& kind, const std::string& example, std::size_t count) {
  if (count == 0) return;
  const auto known = std::find_if(all_.begin(), all_.end(), [&](const Problem& p) { return p.kind == kind; });
  if (known != all_.end()) {
    known->count += count;
  } else {
    all_.push_back({kind, example, count});
  }
}

void Problems::add_altered(const std::string& kind, const std::string& example, std::size_t count) {
  if (count == 0) return;
  add(kind, example, count);
  for (Problem& problem : all_) {
    if (problem.kind == kind) problem.altered = true;
  }
}

void Problems::add(const Problems& others) {
  for (const Problem& problem : others.all_) {
    if (problem.altered) {
      add_altered(problem.kind, problem.example, problem.count);
    } else {
      add(problem.kind, problem.example, problem.count);
    }
  }
}

std::size_t Problems::count(const std::string& kind) const {
  for (const Problem& problem : all_) {
    if (problem.kind == kind) return problem.count;
  }
  return 0;
}

std::string to_string(const Problem& problem) {
  if (problem.count == 1) return problem.kind + " (" + problem.example + ")";
  return problem.kind + " (" + std::to_string(problem.count) + " times, first: " + problem.example + ")";
}

void require_unaltered(const Problems& problems) {
  for (const Problem& problem : problems.all()) {
    if (problem.altered)
      throw InputError(to_string(problem) +
                       ": refused, because strict reading allows no repair, guess or omission");
  }
}

}  // namespace loopwise
