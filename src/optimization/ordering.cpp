// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/ordering.hpp>

#include <cholmod.h>

#include <algorithm>
#include <limits>
#include <new>
#include <numeric>
#include <string>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

/// Starts and finishes CHOLMOD.
struct Workspace {
  cholmod_common common{};
  Workspace() {
    cholmod_start(&common);
    common.print = 0;
    common.error_handler = nullptr;
  }
  ~Workspace() { cholmod_finish(&common); }
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;
};

}  // namespace

std::vector<std::uint32_t> elimination_order(
    std::size_t variables, const std::vector<std::pair<std::uint32_t, std::uint32_t>>& pairs) {
  if (variables == 0) return {};
  if (variables > static_cast<std::size_t>(std::numeric_limits<int>::max()) ||
      pairs.size() > static_cast<std::size_t>(std::numeric_limits<int>::max()) - variables) {
    throw InputError("too many variables to order");
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> upper;
  upper.reserve(pairs.size() + variables);
  for (const auto& [a, b] : pairs) {
    if (std::max(a, b) >= variables) {
      throw InputError("pair " + std::to_string(a) + " " + std::to_string(b) + ": no such variable");
    }
    if (a != b) upper.emplace_back(std::max(a, b), std::min(a, b));  // (column, row)
  }
  for (std::uint32_t v = 0; v < variables; ++v) upper.emplace_back(v, v);
  std::sort(upper.begin(), upper.end());
  upper.erase(std::unique(upper.begin(), upper.end()), upper.end());

  std::vector<int> start(variables + 1, 0), rows(upper.size());
  for (const auto& [column, row] : upper) ++start[column + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  for (std::size_t k = 0; k < upper.size(); ++k) rows[k] = static_cast<int>(upper[k].second);
  cholmod_sparse graph{};
  graph.nrow = graph.ncol = variables;
  graph.nzmax = rows.size();
  graph.p = start.data();
  graph.i = rows.data();
  graph.stype = 1;
  graph.itype = CHOLMOD_INT;
  graph.xtype = CHOLMOD_PATTERN;
  graph.dtype = CHOLMOD_DOUBLE;
  graph.sorted = 1;
  graph.packed = 1;

  Workspace workspace;
  std::vector<int> permutation(variables), parent(variables), post(variables), counts(variables),
      first(variables), level(variables);
  cholmod_amd(&graph, nullptr, 0, permutation.data(), &workspace.common);
  if (workspace.common.status >= CHOLMOD_OK) {
    cholmod_analyze_ordering(&graph, CHOLMOD_GIVEN, permutation.data(), nullptr, 0, parent.data(),
                             post.data(), counts.data(), first.data(), level.data(), &workspace.common);
  }
  if (workspace.common.status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
  if (workspace.common.status < CHOLMOD_OK) {
    throw Error("ordering: CHOLMOD status " + std::to_string(workspace.common.status));
  }
  std::vector<std::uint32_t> order(variables);
  for (std::size_t k = 0; k < variables; ++k) {
    order[k] = static_cast<std::uint32_t>(permutation[static_cast<std::size_t>(post[k])]);
  }
  return order;
}

}  // namespace loopwise
