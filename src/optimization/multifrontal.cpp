// SPDX-License-Identifier: BSD-3-Clause
#include "multifrontal.hpp"

#include <algorithm>
#include <cstring>

#include "front.hpp"

namespace loopwise::detail {
namespace {

/// Merging a panel with its last child adds zeros to L but saves a front. The allowed share of zeros depends
/// on the width.
bool worth_merging(std::size_t block_columns, double zeros, double entries) {
  const double share = zeros / entries;
  return block_columns <= 2 ? share < 0.4 : block_columns <= 8 ? share < 0.2 : share < 0.05;
}

/// Below this number of operations, threads cost more than they save.
constexpr double kLeastParallelFlops = 5e7;
/// A thread gets subtrees of at most one part in kSubtreesOfWork of the work.
constexpr double kSubtreesOfWork = 16.0;

}  // namespace

MultifrontalCholesky::MultifrontalCholesky(const BlockPattern& pattern, const std::vector<int>& parent,
                                           const std::vector<int>& count)
    : broken_at_(count.size()) {
  make_panels(parent, count);
  make_rows(pattern);
}

void MultifrontalCholesky::make_panels(const std::vector<int>& parent, const std::vector<int>& count) {
  struct Panel {
    std::uint32_t first;
    std::size_t width, height;
    double zeros;
    int parent;  // column
  };
  std::vector<Panel> panels;
  const std::size_t n = count.size();
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
      if (!worth_merging(merged.width, merged.zeros, entries)) break;
      panels.pop_back();
      panels.back() = merged;
    }
    v = end;
  }
  std::vector<int> owner(n);
  for (std::size_t s = 0; s < panels.size(); ++s) {
    first_.push_back(panels[s].first);
    std::fill_n(owner.begin() + panels[s].first, panels[s].width, static_cast<int>(s));
  }
  first_.push_back(static_cast<std::uint32_t>(n));
  for (const Panel& panel : panels) {
    parent_.push_back(panel.parent < 0 ? -1 : owner[static_cast<std::size_t>(panel.parent)]);
  }
}

void MultifrontalCholesky::make_rows(const BlockPattern& pattern) {
  const std::size_t n = first_.back();
  std::vector<std::uint32_t> seen(n, UINT32_MAX), index(n, 0);
  std::vector<std::size_t> waiting;  // panels whose parent has not been visited
  std::size_t top = 0;
  places_.resize(pattern.rows.size());
  row_start_.push_back(0);
  value_start_.push_back(0);
  for (std::size_t s = 0; s < size(); ++s) {
    const std::uint32_t end = first_[s + 1];
    const auto mark = static_cast<std::uint32_t>(s);
    const auto add = [&](std::uint32_t row) {
      if (row < end || seen[row] == mark) return;
      seen[row] = mark;
      rows_.push_back(row);
    };
    for (std::size_t p = pattern.start[first_[s]]; p < pattern.start[end]; ++p) add(pattern.rows[p]);
    std::size_t children = waiting.size();
    while (children > 0 && parent_[waiting[children - 1]] == static_cast<int>(s)) --children;
    for (std::size_t c = children; c < waiting.size(); ++c) {
      for (std::size_t p = row_start_[waiting[c]]; p < row_start_[waiting[c] + 1]; ++p) add(rows_[p]);
    }
    std::sort(rows_.begin() + static_cast<std::ptrdiff_t>(row_start_[s]), rows_.end());
    row_start_.push_back(rows_.size());
    relative_.resize(rows_.size());

    const std::uint32_t columns = end - first_[s];
    for (std::uint32_t v = first_[s]; v < end; ++v) index[v] = v - first_[s];
    for (std::size_t p = row_start_[s]; p < row_start_[s + 1]; ++p) {
      index[rows_[p]] = columns + static_cast<std::uint32_t>(p - row_start_[s]);
    }
    std::size_t base = top;
    for (std::size_t c = children; c < waiting.size(); ++c) {
      for (std::size_t p = row_start_[waiting[c]]; p < row_start_[waiting[c] + 1]; ++p)
        relative_[p] = index[rows_[p]];
      base -= update_size(waiting[c]);
    }
    waiting.resize(children);
    stack_size_ = std::max(stack_size_, top + update_size(s));
    top = base + update_size(s);
    if (row_start_[s + 1] > row_start_[s]) waiting.push_back(s);

    block_start_.push_back(pattern.start[first_[s]]);
    for (std::uint32_t v = first_[s]; v < end; ++v) {
      for (std::size_t p = pattern.start[v]; p < pattern.start[v + 1]; ++p) {
        places_[p] = {6 * index[pattern.rows[p]], 6 * (v - first_[s])};
      }
    }
    const auto height = static_cast<std::size_t>(width(s) + below(s));
    value_start_.push_back(value_start_.back() + height * static_cast<std::size_t>(width(s)));
  }
  block_start_.push_back(pattern.rows.size());
}

void MultifrontalCholesky::add_child(std::size_t child, const double* update, std::size_t s, double* l,
                                     double* u) const {
  add_update(relative_.data() + row_start_[child], row_start_[child + 1] - row_start_[child], update,
             first_[s + 1] - first_[s], static_cast<std::size_t>(below(s)), l, u);
}

void MultifrontalCholesky::load_panel(std::size_t s, const double* values, double* l) const {
  const auto h = static_cast<std::size_t>(width(s) + below(s));
  std::fill_n(l, h * static_cast<std::size_t>(width(s)), 0.0);
  for (std::size_t p = block_start_[s]; p < block_start_[s + 1]; ++p) {
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
  std::size_t broken_at = 0;  ///< Block column
};

/// Factorises panels begin … end − 1; their children are among them or among the waiting updates.
bool MultifrontalCholesky::factorize_range(std::size_t begin, std::size_t end, const double* values,
                                           Run& run) {
  const FrontKernels& kernel = front_kernels();
  for (std::size_t s = begin; s < end; ++s) {
    const int w = width(s), m = below(s), h = w + m;
    double* l = values_.data() + value_start_[s];
    double* u = run.stack + run.top;
    load_panel(s, values, l);
    const auto has_child = [&] {
      return !run.waiting.empty() && parent_[run.waiting.back().panel] == static_cast<int>(s);
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
    const int done = eliminate_columns(kernel, w, h, l);
    if (done < w) {
      run.broken_at = first_[s] + static_cast<std::size_t>(done / 6);
      return false;
    }
    run.top = base;
    if (m == 0) continue;
    subtract_product(kernel, m, w, l + w, h, u, leaf);
    std::memmove(run.stack + base, u, update_size(s) * sizeof(double));
    run.waiting.push_back({s, run.stack + base, update_size(s)});
    run.top += update_size(s);
  }
  return true;
}

bool MultifrontalCholesky::factorize(const double* values, ThreadPool* pool) {
  values_.resize(value_start_.back());
  if (!stack_) stack_.reset(new double[stack_size_]);
  broken_at_ = first_.back();
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
    if (!factorize_range(at, subtrees[k].begin, values, top)) return broken(top);
    if (sound[k] == 0) return broken(runs[k]);
    for (Run::Update update : runs[k].waiting) {
      update.size = 0;
      top.waiting.push_back(update);
    }
    at = subtrees[k].end;
  }
  return factorize_range(at, size(), values, top) || broken(top);
}

bool MultifrontalCholesky::broken(const Run& run) {
  broken_at_ = run.broken_at;
  return false;
}

/// Disjoint subtrees, each a small part of the work, in order.
std::vector<MultifrontalCholesky::Subtree> MultifrontalCholesky::independent_subtrees() const {
  std::vector<double> flops(size());
  std::vector<std::size_t> first(size());
  double all = 0.0;
  for (std::size_t s = 0; s < size(); ++s) {
    const double w = width(s), m = below(s);
    const double own = w * (w * w / 3.0 + w * m + m * m);
    all += own;
    flops[s] += own;
  }
  std::vector<double> of_subtree = flops;
  for (std::size_t s = 0; s < size(); ++s) first[s] = s;
  for (std::size_t s = 0; s < size(); ++s) {
    if (parent_[s] < 0) continue;
    const auto p = static_cast<std::size_t>(parent_[s]);
    of_subtree[p] += of_subtree[s];
    first[p] = std::min(first[p], first[s]);
  }
  std::vector<Subtree> out;
  if (all < kLeastParallelFlops) return out;
  const auto is_small = [&](std::size_t s) { return of_subtree[s] <= all / kSubtreesOfWork; };
  for (std::size_t s = 0; s < size(); ++s) {
    if (!is_small(s) || (parent_[s] >= 0 && is_small(static_cast<std::size_t>(parent_[s])))) continue;
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
    while (!waiting.empty() && parent_[waiting.back()] == static_cast<int>(s)) {
      top -= update_size(waiting.back());
      waiting.pop_back();
    }
    top += update_size(s);
    if (below(s) > 0) waiting.push_back(s);
  }
  return std::max<std::size_t>(most, 1);
}

void MultifrontalCholesky::solve(double* x) const {
  solve_lower(x);
  solve_upper(x);
}

void MultifrontalCholesky::solve_lower(double* x) const {
  const FrontKernels& kernel = front_kernels();
  std::vector<double> gathered;
  for (std::size_t s = 0; s < size(); ++s) {
    double* top = x + 6 * static_cast<std::size_t>(first_[s]);
    if (std::all_of(top, top + width(s), [](double value) { return value == 0.0; })) continue;
    solve_front_lower(kernel, width(s), below(s), values_.data() + value_start_[s],
                      rows_.data() + row_start_[s], top, x, gathered);
  }
}

void MultifrontalCholesky::solve_upper(double* x) const {
  const FrontKernels& kernel = front_kernels();
  std::vector<double> gathered;
  for (std::size_t s = size(); s-- > 0;) {
    solve_front_upper(kernel, width(s), below(s), values_.data() + value_start_[s],
                      rows_.data() + row_start_[s], x + 6 * static_cast<std::size_t>(first_[s]), x, gathered);
  }
}

std::vector<double> MultifrontalCholesky::pivots() const {
  std::vector<double> out;
  out.reserve(6 * static_cast<std::size_t>(first_.back()));
  for (std::size_t s = 0; s < size(); ++s) {
    const auto h = static_cast<std::size_t>(width(s) + below(s));
    const double* l = values_.data() + value_start_[s];
    for (std::size_t j = 0; j < static_cast<std::size_t>(width(s)); ++j)
      out.push_back(l[j * (h + 1)] * l[j * (h + 1)]);
  }
  return out;
}

Panels MultifrontalCholesky::shape() const {
  Panels out;
  out.first.reserve(first_.size());
  for (const std::uint32_t v : first_) out.first.push_back(6 * static_cast<int>(v));
  out.value_start = value_start_;
  out.row_start.push_back(0);
  const auto add = [&](std::uint32_t v) {
    for (int r = 0; r < 6; ++r) out.rows.push_back(6 * static_cast<int>(v) + r);
  };
  out.rows.reserve(6 * (rows_.size() + first_.back()));
  for (std::size_t s = 0; s < size(); ++s) {
    for (std::uint32_t v = first_[s]; v < first_[s + 1]; ++v) add(v);
    for (std::size_t p = row_start_[s]; p < row_start_[s + 1]; ++p) add(rows_[p]);
    out.row_start.push_back(out.rows.size());
  }
  return out;
}

Panels MultifrontalCholesky::panels() const {
  Panels out = shape();
  out.values = values_;
  return out;
}

Panels MultifrontalCholesky::take_panels() {
  Panels out = shape();
  out.values.swap(values_);
  return out;
}

}  // namespace loopwise::detail
