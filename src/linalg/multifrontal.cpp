// SPDX-License-Identifier: BSD-3-Clause
#include "multifrontal.hpp"

#include <algorithm>
#include <cstring>

namespace loopwise::detail {
namespace {

/// Merging a panel with its last child adds zeros to L but saves a front. The allowed share of zeros depends
/// on the width.
bool worth_merging(std::size_t block_columns, double zeros, double entries, double most_zeros) {
  if (zeros == 0.0 || most_zeros == 0.0) return zeros == 0.0;
  const double share = zeros / (most_zeros * entries);
  return block_columns <= 2 ? share < 0.4 : block_columns <= 8 ? share < 0.2 : share < 0.05;
}

/// Below this number of operations, threads cost more than they save.
constexpr double kLeastParallelFlops = 5e7;
/// A thread gets subtrees of at most one part in kSubtreesOfWork of the work.
constexpr double kSubtreesOfWork = 16.0;

}  // namespace

void MultifrontalCholesky::analyze(const Elimination& elimination, double most_zeros) {
  make_panels(elimination.parent, elimination.count, most_zeros);
  make_rows(elimination.lower);
}

void MultifrontalCholesky::make_panels(const std::vector<int>& parent, const std::vector<int>& count,
                                       double most_zeros) {
  struct Panel {
    std::uint32_t first;
    std::size_t width, height;
    double zeros;
    int parent;  // column
  };
  std::vector<Panel> panels;
  const std::size_t n = count.size();
  panels.reserve(n);
  for (std::size_t v = 0; v < n;) {
    std::size_t end = v + 1;
    while (end < n && parent[end - 1] == static_cast<int>(end) && count[end - 1] == count[end] + 1) ++end;
    panels.push_back(
        {static_cast<std::uint32_t>(v), end - v, static_cast<std::size_t>(count[v]), 0.0, parent[end - 1]});
    // In postorder the panel before this one is its last child, unless this one is a leaf.
    while (panels.size() > 1) {
      const Panel& child = panels[panels.size() - 2];
      const Panel& last = panels.back();
      if (child.parent < static_cast<int>(last.first) || child.parent >= static_cast<int>(end)) break;
      Panel merged = child;
      merged.width += last.width;
      merged.height = child.width + last.height;
      merged.parent = last.parent;
      merged.zeros += last.zeros + static_cast<double>(child.width * (merged.height - child.height));
      const double entries = static_cast<double>(merged.width) *
                             (static_cast<double>(merged.height) - 0.5 * static_cast<double>(merged.width));
      if (!worth_merging(merged.width, merged.zeros, entries, most_zeros)) break;
      panels.pop_back();
      panels.back() = merged;
    }
    v = end;
  }
  l_.owner.resize(n);
  l_.first.clear();
  l_.parent.clear();
  for (std::size_t s = 0; s < panels.size(); ++s) {
    l_.first.push_back(panels[s].first);
    std::fill_n(l_.owner.begin() + panels[s].first, panels[s].width, static_cast<std::uint32_t>(s));
  }
  l_.first.push_back(static_cast<std::uint32_t>(n));
  for (const Panel& panel : panels) {
    const bool root = panel.parent < 0;
    l_.parent.push_back(root ? -1 : static_cast<int>(l_.owner[static_cast<std::size_t>(panel.parent)]));
  }
}

void MultifrontalCholesky::make_rows(const BlockPattern& pattern) {
  const std::size_t n = l_.block_columns();
  std::vector<std::uint32_t> seen(n, UINT32_MAX), index(n, 0);
  std::vector<std::size_t> waiting;  // panels whose parent has not been visited
  std::size_t top = 0;
  stack_size_ = 0;
  places_.resize(pattern.rows.size());
  block_start_ = pattern.start;
  l_.rows.clear();
  l_.row_start.assign(1, 0);
  l_.value_start.assign(1, 0);
  for (std::size_t s = 0; s < l_.size(); ++s) {
    const std::uint32_t begin = l_.first[s], end = l_.first[s + 1];
    const auto mark = static_cast<std::uint32_t>(s);
    const auto add = [&](std::uint32_t row) {
      if (row < end || seen[row] == mark) return;
      seen[row] = mark;
      l_.rows.push_back(row);
    };
    for (std::size_t p = pattern.start[begin]; p < pattern.start[end]; ++p) add(pattern.rows[p]);
    std::size_t children = waiting.size();
    while (children > 0 && l_.parent[waiting[children - 1]] == static_cast<int>(s)) --children;
    for (std::size_t c = children; c < waiting.size(); ++c) {
      for (std::size_t p = l_.row_start[waiting[c]]; p < l_.row_start[waiting[c] + 1]; ++p) add(l_.rows[p]);
    }
    std::sort(l_.rows.begin() + static_cast<std::ptrdiff_t>(l_.row_start[s]), l_.rows.end());
    l_.row_start.push_back(l_.rows.size());
    relative_.resize(l_.rows.size());

    const std::uint32_t columns = end - begin;
    for (std::uint32_t v = begin; v < end; ++v) index[v] = v - begin;
    for (std::size_t p = l_.row_start[s]; p < l_.row_start[s + 1]; ++p) {
      index[l_.rows[p]] = columns + static_cast<std::uint32_t>(p - l_.row_start[s]);
    }
    std::size_t base = top;
    for (std::size_t c = children; c < waiting.size(); ++c) {
      for (std::size_t p = l_.row_start[waiting[c]]; p < l_.row_start[waiting[c] + 1]; ++p)
        relative_[p] = index[l_.rows[p]];
      base -= update_size(waiting[c]);
    }
    waiting.resize(children);
    stack_size_ = std::max(stack_size_, top + update_size(s));
    top = base + update_size(s);
    if (l_.row_start[s + 1] > l_.row_start[s]) waiting.push_back(s);

    for (std::uint32_t v = begin; v < end; ++v) {
      for (std::size_t p = pattern.start[v]; p < pattern.start[v + 1]; ++p) {
        places_[p] = {6 * index[pattern.rows[p]], 6 * (v - begin)};
      }
    }
    l_.value_start.push_back(l_.value_start.back() + static_cast<std::size_t>(l_.height(s)) *
                                                         static_cast<std::size_t>(l_.columns(s)));
  }
}

void MultifrontalCholesky::add_child(std::size_t child, const double* update, std::size_t s, double* l,
                                     double* u) const {
  add_update(relative_.data() + l_.row_start[child], l_.row_start[child + 1] - l_.row_start[child], update,
             l_.first[s + 1] - l_.first[s], static_cast<std::size_t>(l_.below(s)), l, u);
}

void MultifrontalCholesky::load_panel(std::size_t s, const double* values, double* l) const {
  const auto h = static_cast<std::size_t>(l_.height(s));
  std::fill_n(l, h * static_cast<std::size_t>(l_.columns(s)), 0.0);
  for (std::size_t p = block_start_[l_.first[s]]; p < block_start_[l_.first[s + 1]]; ++p) {
    double* to = l + places_[p].column * h + places_[p].row;
    const double* from = values + 36 * p;
    for (int c = 0; c < 6; ++c, to += h, from += 6) std::memcpy(to, from, 6 * sizeof(double));
  }
}

/// Stack memory of one run, and the updates that its later panels will use.
struct MultifrontalCholesky::Run {
  struct Update {
    std::size_t panel;
    const double* u;
    std::size_t size;  ///< On this run's stack; 0 if on another run's stack
  };
  double* stack;
  std::size_t top = 0;
  std::vector<Update> waiting{};
  Pivot smallest{};
};

/// Factorises panels begin … end − 1; their children are among them or among the waiting updates.
bool MultifrontalCholesky::factorize_range(std::size_t begin, std::size_t end, const double* values,
                                           Run& run) {
  for (std::size_t s = begin; s < end; ++s) {
    const int w = l_.columns(s), m = l_.below(s), h = w + m;
    double* l = l_.values.data() + l_.value_start[s];
    double* u = run.stack + run.top;
    load_panel(s, values, l);
    const auto has_child = [&] {
      return !run.waiting.empty() && l_.parent[run.waiting.back().panel] == static_cast<int>(s);
    };
    const bool leaf = !has_child();
    for (int c = 0; c < m && !leaf; ++c) {
      const int first = c - c % 6;  // whole blocks, the diagonal one included
      std::fill_n(u + static_cast<std::ptrdiff_t>(c) * m + first, m - first, 0.0);
    }
    std::size_t base = run.top;
    while (has_child()) {
      const Run::Update& child = run.waiting.back();
      base -= child.size;
      add_child(child.panel, child.u, s, l, u);
      run.waiting.pop_back();
    }
    const int done = eliminate_columns(kernels_, w, h, l);
    if (done < w) {
      run.smallest = {0.0, l_.first[s] + static_cast<std::size_t>(done / 6)};
      return false;
    }
    find_smallest_pivot(s, values, l, run.smallest);
    run.top = base;
    if (m == 0) continue;
    subtract_product(kernels_, m, w, l + w, h, u, leaf);
    std::memmove(run.stack + base, u, update_size(s) * sizeof(double));
    run.waiting.push_back({s, run.stack + base, update_size(s)});
    run.top += update_size(s);
  }
  return true;
}

bool MultifrontalCholesky::factorize(const double* values, ThreadPool* pool) {
  l_.values.resize(l_.value_start.back());
  if (stack_capacity_ < stack_size_) {
    stack_.reset();
    stack_capacity_ = 0;
    stack_.reset(new double[stack_size_]);
    stack_capacity_ = stack_size_;
  }
  smallest_ = {};
  Run top{stack_.get()};
  std::vector<Subtree> subtrees;
  if (pool != nullptr && pool->num_threads() > 1) subtrees = independent_subtrees();
  std::vector<Run> runs;
  std::vector<std::unique_ptr<double[]>> stacks;
  for (const Subtree& subtree : subtrees) {
    stacks.emplace_back(new double[subtree.stack_size]);
    runs.push_back({stacks.back().get()});
  }
  std::vector<char> sound(subtrees.size(), 0);
  if (pool != nullptr) {
    pool->for_each(subtrees.size(), [&](std::size_t k) {
      sound[k] = factorize_range(subtrees[k].begin, subtrees[k].end, values, runs[k]) ? 1 : 0;
    });
  }
  // Fronts add their children in a fixed order, so the result is the same to the bit for any number of
  // threads.
  std::size_t at = 0;
  for (std::size_t k = 0; k < subtrees.size(); ++k) {
    if (!account(top, factorize_range(at, subtrees[k].begin, values, top))) return false;
    if (!account(runs[k], sound[k] != 0)) return false;
    for (Run::Update update : runs[k].waiting) {
      update.size = 0;
      top.waiting.push_back(update);
    }
    at = subtrees[k].end;
  }
  return account(top, factorize_range(at, l_.size(), values, top));
}

/// Takes over the smallest pivot of a run, whose last panel failed unless it is sound.
bool MultifrontalCholesky::account(const Run& run, bool sound) {
  if (!sound || run.smallest.ratio < smallest_.ratio) smallest_ = run.smallest;
  return sound;
}

/// \param values of the matrix; the diagonal block is the first one of a column
void MultifrontalCholesky::find_smallest_pivot(std::size_t s, const double* values, const double* l,
                                               Pivot& smallest) const {
  const auto next = static_cast<std::size_t>(l_.height(s)) + 1;
  for (std::size_t v = l_.first[s]; v < l_.first[s + 1]; ++v) {
    const double* diagonal = values + 36 * block_start_[v];
    for (int k = 0; k < 6; ++k, diagonal += 7, l += next) {
      const double pivot = *l * *l;
      // Divides only where the ratio may become smaller; the bound leaves room for its rounding.
      if (pivot > smallest.ratio * *diagonal * (1.0 + 1e-12)) continue;
      const double ratio = pivot / *diagonal;
      if (ratio < smallest.ratio) smallest = {ratio, v};
    }
  }
}

/// Disjoint subtrees, each a small part of the work, in order.
std::vector<MultifrontalCholesky::Subtree> MultifrontalCholesky::independent_subtrees() const {
  std::vector<double> flops(l_.size());
  std::vector<std::size_t> first(l_.size());
  double all = 0.0;
  for (std::size_t s = 0; s < l_.size(); ++s) {
    const double w = l_.columns(s), m = l_.below(s);
    const double own = w * (w * w / 3.0 + w * m + m * m);
    all += own;
    flops[s] += own;
  }
  std::vector<double> of_subtree = flops;
  for (std::size_t s = 0; s < l_.size(); ++s) first[s] = s;
  for (std::size_t s = 0; s < l_.size(); ++s) {
    if (l_.parent[s] < 0) continue;
    const auto p = static_cast<std::size_t>(l_.parent[s]);
    of_subtree[p] += of_subtree[s];
    first[p] = std::min(first[p], first[s]);
  }
  std::vector<Subtree> out;
  if (all < kLeastParallelFlops) return out;
  const auto is_small = [&](std::size_t s) { return of_subtree[s] <= all / kSubtreesOfWork; };
  for (std::size_t s = 0; s < l_.size(); ++s) {
    if (!is_small(s) || (l_.parent[s] >= 0 && is_small(static_cast<std::size_t>(l_.parent[s])))) continue;
    out.push_back({first[s], s + 1, stack_size(first[s], s + 1)});
  }
  return out;
}

/// The largest size of factorize_range()'s stack.
std::size_t MultifrontalCholesky::stack_size(std::size_t begin, std::size_t end) const {
  std::vector<std::size_t> waiting;
  std::size_t top = 0, most = 0;
  for (std::size_t s = begin; s < end; ++s) {
    most = std::max(most, top + update_size(s));
    while (!waiting.empty() && l_.parent[waiting.back()] == static_cast<int>(s)) {
      top -= update_size(waiting.back());
      waiting.pop_back();
    }
    top += update_size(s);
    if (l_.below(s) > 0) waiting.push_back(s);
  }
  return std::max<std::size_t>(most, 1);
}

void MultifrontalCholesky::solve(double* x) const {
  solve_lower(x);
  solve_upper(x);
}

void MultifrontalCholesky::solve_lower(double* x) const {
  std::vector<double> gathered;
  for (std::size_t s = 0; s < l_.size(); ++s) {
    double* top = x + 6 * static_cast<std::size_t>(l_.first[s]);
    if (std::all_of(top, top + l_.columns(s), [](double value) { return value == 0.0; })) continue;
    solve_front_lower(kernels_, l_.columns(s), l_.below(s), l_.values.data() + l_.value_start[s],
                      l_.rows.data() + l_.row_start[s], top, x, gathered);
  }
}

void MultifrontalCholesky::solve_upper(double* x) const {
  std::vector<double> gathered;
  for (std::size_t s = l_.size(); s-- > 0;) {
    solve_front_upper(kernels_, l_.columns(s), l_.below(s), l_.values.data() + l_.value_start[s],
                      l_.rows.data() + l_.row_start[s], x + 6 * static_cast<std::size_t>(l_.first[s]), x,
                      gathered);
  }
}

}  // namespace loopwise::detail
