// SPDX-License-Identifier: BSD-3-Clause
#include "elimination.hpp"

#include <cholmod.h>

#include <algorithm>
#include <limits>
#include <new>
#include <numeric>
#include <string>

#include <loopwise/core/error.hpp>

#include "blas_threads.hpp"

namespace loopwise::detail {
namespace {

/// Operations of a factorisation from which on a nested dissection is tried: computing it costs more than it
/// saves in shorter ones.
constexpr double kLongFactorization = 2e9;

/// CHOLMOD for the time of an analysis.
class Orderings {
 public:
  explicit Orderings(const BlockPattern& upper) {
    cholmod_start(&common_);
    common_.print = 0;
    common_.error_handler = nullptr;
    common_.try_catch = 1;
    start_.assign(upper.start.begin(), upper.start.end());
    rows_.assign(upper.rows.begin(), upper.rows.end());
    graph_.nrow = graph_.ncol = upper.columns();
    graph_.nzmax = rows_.size();
    graph_.p = start_.data();
    graph_.i = rows_.data();
    graph_.stype = 1;
    graph_.itype = CHOLMOD_INT;
    graph_.xtype = CHOLMOD_PATTERN;
    graph_.dtype = CHOLMOD_DOUBLE;
    graph_.sorted = 1;
    graph_.packed = 1;
  }
  ~Orderings() { cholmod_finish(&common_); }
  Orderings(const Orderings&) = delete;
  Orderings& operator=(const Orderings&) = delete;

  std::vector<std::uint32_t> minimum_degree() {
    std::vector<int> permutation(graph_.ncol);
    cholmod_amd(&graph_, nullptr, 0, permutation.data(), &common_);
    if (common_.status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
    if (common_.status < CHOLMOD_OK) {
      throw Error("ordering: CHOLMOD status " + std::to_string(common_.status));
    }
    return {permutation.begin(), permutation.end()};
  }

  /// Empty if METIS failed. It stops without an error if a signal to terminate reaches the process meanwhile.
  std::vector<std::uint32_t> nested_dissection() {
    std::vector<int> permutation(graph_.ncol);
    cholmod_metis(&graph_, nullptr, 0, 0, permutation.data(), &common_);
    if (common_.status != CHOLMOD_OK || !is_permutation(permutation)) return {};
    return {permutation.begin(), permutation.end()};
  }

 private:
  static bool is_permutation(const std::vector<int>& p) {
    std::vector<char> seen(p.size(), 0);
    for (const int i : p) {
      if (i < 0 || static_cast<std::size_t>(i) >= p.size() || seen[static_cast<std::size_t>(i)] != 0)
        return false;
      seen[static_cast<std::size_t>(i)] = 1;
    }
    return true;
  }

  cholmod_common common_{};
  std::vector<int> start_, rows_;
  cholmod_sparse graph_{};
};

/// Elimination tree of a matrix from the earlier neighbours of each column (Liu, ACM TOMS 1986).
std::vector<int> elimination_tree(const BlockPattern& earlier) {
  const std::size_t n = earlier.columns();
  std::vector<int> parent(n, -1), ancestor(n, -1);
  for (std::size_t k = 0; k < n; ++k) {
    const int column = static_cast<int>(k);
    for (std::size_t p = earlier.start[k]; p < earlier.start[k + 1]; ++p) {
      // Ancestors are set to this column on the way, so that later visits of the path are short.
      for (int i = static_cast<int>(earlier.rows[p]); i != -1 && i < column;) {
        const int next = ancestor[static_cast<std::size_t>(i)];
        ancestor[static_cast<std::size_t>(i)] = column;
        if (next == -1) parent[static_cast<std::size_t>(i)] = column;
        i = next;
      }
    }
  }
  return parent;
}

/// Position of each column in the postorder of the tree; children ascend.
std::vector<std::uint32_t> postorder(const std::vector<int>& parent) {
  const std::size_t n = parent.size();
  std::vector<int> child(n, -1), sibling(n, -1), stack;
  int root = -1;
  for (std::size_t k = n; k-- > 0;) {
    int& head = parent[k] < 0 ? root : child[static_cast<std::size_t>(parent[k])];
    sibling[k] = head;
    head = static_cast<int>(k);
  }
  std::vector<std::uint32_t> position(n);
  std::uint32_t next = 0;
  for (; root != -1; root = sibling[static_cast<std::size_t>(root)]) {
    stack.push_back(root);
    while (!stack.empty()) {
      const auto top = static_cast<std::size_t>(stack.back());
      if (child[top] != -1) {
        stack.push_back(child[top]);
        child[top] = sibling[static_cast<std::size_t>(child[top])];
      } else {
        position[top] = next++;
        stack.pop_back();
      }
    }
  }
  return position;
}

/// Blocks in each column of L: row i of L has an element in every column on the paths of the elimination tree
/// from the elements of row i of the matrix to i.
std::vector<int> column_counts(const BlockPattern& upper, const std::vector<int>& parent) {
  const std::size_t n = parent.size();
  std::vector<int> count(n, 1), seen(n, -1);
  for (std::size_t i = 0; i < n; ++i) {
    const int row = static_cast<int>(i);
    seen[i] = row;
    for (std::size_t p = upper.start[i]; p < upper.start[i + 1]; ++p) {
      for (auto j = static_cast<std::size_t>(upper.rows[p]); seen[j] != row;
           j = static_cast<std::size_t>(parent[j])) {
        seen[j] = row;
        ++count[j];
      }
    }
  }
  return count;
}

/// Columns with a smaller number that each column has an element with; in no order, and possibly repeated.
BlockPattern earlier_neighbours(const std::vector<BlockPair>& pairs,
                                const std::vector<std::uint32_t>& place) {
  BlockPattern out;
  out.start.assign(place.size() + 1, 0);
  for (const auto& [a, b] : pairs) ++out.start[std::max(place[a], place[b]) + 1];
  std::partial_sum(out.start.begin(), out.start.end(), out.start.begin());
  out.rows.resize(out.start.back());
  std::vector<std::size_t> next(out.start.begin(), out.start.end() - 1);
  for (const auto& [a, b] : pairs) {
    const auto [small, large] = std::minmax(place[a], place[b]);
    out.rows[next[large]++] = small;
  }
  return out;
}

}  // namespace

double Elimination::work() const {
  double sum = 0.0;
  for (const int blocks : count) sum += static_cast<double>(blocks) * blocks;
  return sum;
}

Elimination analyze_order(const std::vector<std::uint32_t>& order, const std::vector<BlockPair>& pairs) {
  const std::size_t n = order.size();
  std::vector<std::uint32_t> place(n);
  for (std::uint32_t k = 0; k < n; ++k) place[order[k]] = k;
  const std::vector<int> parent = elimination_tree(earlier_neighbours(pairs, place));
  const std::vector<std::uint32_t> post = postorder(parent);
  Elimination out;
  out.position.resize(n);
  out.parent.resize(n);
  for (std::size_t v = 0; v < n; ++v) out.position[v] = post[place[v]];
  for (std::size_t k = 0; k < n; ++k) {
    out.parent[post[k]] = parent[k] < 0 ? -1 : static_cast<int>(post[static_cast<std::size_t>(parent[k])]);
  }
  out.lower = lower_pattern(pairs, out.position);
  out.count = column_counts(transposed(out.lower), out.parent);
  return out;
}

Elimination fill_reducing_elimination(std::size_t variables, const std::vector<BlockPair>& pairs,
                                      int block_size, Dissection dissection) {
  constexpr auto kMost = static_cast<std::size_t>(std::numeric_limits<int>::max());
  if (variables * static_cast<std::size_t>(block_size) > kMost || pairs.size() > kMost)
    throw Error("the graph has too many nodes or edges for one factorisation");
  if (variables == 0) return analyze_order({}, pairs);  // CHOLMOD refuses an empty graph
  const SingleThreadedBlas guard;
  std::vector<std::uint32_t> identity(variables);
  std::iota(identity.begin(), identity.end(), 0U);
  Orderings orderings(transposed(lower_pattern(pairs, identity)));
  Elimination best = analyze_order(orderings.minimum_degree(), pairs);
  const double b = block_size;
  if (dissection == Dissection::kIfLong && best.work() * b * b * b > kLongFactorization) {
    const std::vector<std::uint32_t> order = orderings.nested_dissection();
    if (order.empty()) return best;
    Elimination other = analyze_order(order, pairs);
    if (other.work() < best.work()) return other;
  }
  return best;
}

}  // namespace loopwise::detail
