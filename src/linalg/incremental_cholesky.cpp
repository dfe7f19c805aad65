// SPDX-License-Identifier: BSD-3-Clause
#include "incremental_cholesky.hpp"

#include <algorithm>
#include <cmath>

#include "front.hpp"

namespace loopwise::detail {
namespace {

/// Width of a front of appended variables, in block columns: they are dense among each other.
constexpr std::uint32_t kAppendedWidth = 16;

}  // namespace

double IncrementalCholesky::Front::flops() const {
  const double w = width(), m = below();
  return w * (w * w / 3.0 + w * m + m * m);
}

double IncrementalCholesky::flops() const {
  double sum = 0.0;
  for (const Front& front : fronts_) sum += front.flops();
  return sum;
}

void IncrementalCholesky::analyze(std::size_t variables, const std::vector<BlockPair>& pairs) {
  *this = {};
  if (variables == 0) return;
  Elimination elimination = fill_reducing_elimination(variables, pairs, 6, Dissection::kIfLong);
  MultifrontalCholesky symbolic(Rounding::kFastest);
  symbolic.analyze(elimination, 1.0);
  position_ = std::move(elimination.position);
  variable_at_.resize(variables);
  for (std::uint32_t v = 0; v < variables; ++v) variable_at_[position_[v]] = v;
  index_.resize(variables);
  sqrt_diagonals_.resize(6 * variables);
  owner_.resize(variables);
  const Panels& shape = symbolic.panels();
  fronts_.resize(shape.size());
  first_appended_ = fronts_.size();
  for (std::uint32_t s = 0; s < fronts_.size(); ++s) {
    Front& front = fronts_[s];
    front.first = shape.first[s];
    front.end = shape.first[s + 1];
    front.parent = shape.parent[s];
    front.rows.assign(shape.rows.begin() + static_cast<std::ptrdiff_t>(shape.row_start[s]),
                      shape.rows.begin() + static_cast<std::ptrdiff_t>(shape.row_start[s + 1]));
    std::fill(owner_.begin() + front.first, owner_.begin() + front.end, s);
    if (front.parent >= 0) fronts_[static_cast<std::size_t>(front.parent)].children.push_back(s);
    changed_.push_back(s);
  }
}

void IncrementalCholesky::append() {
  const auto position = static_cast<std::uint32_t>(position_.size());
  position_.push_back(position);
  variable_at_.push_back(position);
  index_.push_back(0);
  sqrt_diagonals_.resize(6 * position_.size());
  const bool widens = fronts_.size() > first_appended_ && fronts_.back().rows.empty() &&
                      fronts_.back().end - fronts_.back().first < kAppendedWidth;
  if (!widens) {
    fronts_.emplace_back();
    fronts_.back().first = position;
    fronts_.back().changed = false;
  }
  fronts_.back().end = position + 1;
  owner_.push_back(static_cast<std::uint32_t>(fronts_.size() - 1));
  mark(owner_.back());
}

void IncrementalCholesky::mark(std::uint32_t front) {
  if (fronts_[front].changed) return;
  fronts_[front].changed = true;
  changed_.push_back(front);
}

void IncrementalCholesky::touch(std::uint32_t variable) {
  mark(owner_[position_[variable]]);
}

void IncrementalCholesky::insert(std::uint32_t a, std::uint32_t b) {
  const auto [column, row] = std::minmax(position_[a], position_[b]);
  mark(owner_[row]);
  mark(owner_[column]);
  add_row(owner_[column], row);
}

/// A front that gains a row passes it to its parent, which then gains it too. If the row comes before the
/// parent's columns, the row's front becomes the parent and gains all rows of the child.
void IncrementalCholesky::add_row(std::uint32_t s, std::uint32_t position) {
  std::vector<std::uint32_t> gained{position}, merged;
  while (true) {
    Front& front = fronts_[s];
    gained.erase(gained.begin(), std::lower_bound(gained.begin(), gained.end(), front.end));
    merged.clear();
    std::set_union(front.rows.begin(), front.rows.end(), gained.begin(), gained.end(),
                   std::back_inserter(merged));
    if (merged.size() == front.rows.size()) return;
    front.rows = merged;
    mark(s);
    const auto parent = static_cast<int>(owner_[front.rows.front()]);
    if (parent != front.parent) {
      if (front.parent >= 0) {
        std::vector<std::uint32_t>& siblings = fronts_[static_cast<std::size_t>(front.parent)].children;
        siblings.erase(std::find(siblings.begin(), siblings.end(), s));
        mark(static_cast<std::uint32_t>(front.parent));
      }
      fronts_[static_cast<std::size_t>(parent)].children.push_back(s);
      front.parent = parent;
      gained = front.rows;
    }
    s = static_cast<std::uint32_t>(parent);
  }
}

std::vector<std::uint32_t> IncrementalCholesky::changed_fronts() {
  for (std::size_t i = 0; i < changed_.size();) {  // grows in the loop
    const int parent = fronts_[changed_[i++]].parent;
    if (parent >= 0) mark(static_cast<std::uint32_t>(parent));
  }
  std::vector<std::uint32_t> out;
  out.swap(changed_);
  // Parents come after their children.
  std::sort(out.begin(), out.end());
  return out;
}

void IncrementalCholesky::begin(std::uint32_t s) {
  Front& front = fronts_[s];
  const auto w = static_cast<std::size_t>(front.width()), m = static_cast<std::size_t>(front.below());
  front.l.assign((w + m) * w, 0.0);
  front.u.resize(m * m);
  // The lower triangle in whole blocks, to which children add.
  for (std::size_t c = 0; c < m && !front.children.empty(); ++c) {
    const std::size_t first = c - c % 6;
    std::fill_n(front.u.data() + c * m + first, m - first, 0.0);
  }
  for (std::uint32_t p = front.first; p < front.end; ++p) index_[p] = p - front.first;
  const std::uint32_t columns = front.end - front.first;
  for (std::uint32_t i = 0; i < front.rows.size(); ++i) index_[front.rows[i]] = columns + i;
}

void IncrementalCholesky::add(Front& front, std::uint32_t column, std::uint32_t row, const Matrix6d& block) {
  const auto h = static_cast<std::size_t>(front.width() + front.below());
  double* to =
      front.l.data() + 6 * std::size_t{column - front.first} * h + 6 * std::size_t{index_[position_[row]]};
  for (int c = 0; c < 6; ++c, to += h) {
    for (int r = 0; r < 6; ++r) to[r] += block(r, c);
  }
}

bool IncrementalCholesky::finish(std::uint32_t s) {
  Front& front = fronts_[s];
  const int w = front.width(), m = front.below(), h = w + m;
  const auto pivot = [&](int j) {
    return front.l[static_cast<std::size_t>(j) * static_cast<std::size_t>(h + 1)];
  };
  diagonal_.resize(static_cast<std::size_t>(w));
  for (int j = 0; j < w; ++j) {
    diagonal_[static_cast<std::size_t>(j)] = pivot(j);
    sqrt_diagonals_[6 * std::size_t{front.first} + static_cast<std::size_t>(j)] = std::sqrt(pivot(j));
  }
  for (const std::uint32_t child : front.children) {
    const Front& from = fronts_[child];
    relative_.clear();
    for (const std::uint32_t p : from.rows) relative_.push_back(index_[p]);
    add_update(relative_.data(), relative_.size(), from.u.data(), front.end - front.first,
               static_cast<std::size_t>(m), front.l.data(), front.u.data());
  }
  const DenseKernels& kernels = dense_kernels(Rounding::kFastest);
  if (eliminate_columns(kernels, w, h, front.l.data()) < w) return false;
  for (int j = 0; j < w; ++j) {
    if (!(pivot(j) * pivot(j) >= kSingularPivot * diagonal_[static_cast<std::size_t>(j)])) return false;
  }
  if (m > 0) subtract_product(kernels, m, w, front.l.data() + w, h, front.u.data(), front.children.empty());
  front.changed = false;
  flops_spent_ += front.flops();
  return true;
}

void IncrementalCholesky::solve(const std::vector<std::uint32_t>& nonzero, double tolerance,
                                std::vector<double>& x, std::vector<std::uint32_t>& visited) {
  visited.clear();
  on_path_.resize(fronts_.size(), 0);
  std::vector<std::uint32_t> path;
  for (const std::uint32_t position : nonzero) {
    for (int s = static_cast<int>(owner_[position]); s >= 0 && on_path_[static_cast<std::size_t>(s)] == 0;
         s = fronts_[static_cast<std::size_t>(s)].parent) {
      on_path_[static_cast<std::size_t>(s)] = 1;
      path.push_back(static_cast<std::uint32_t>(s));
    }
  }
  std::sort(path.begin(), path.end());
  const DenseKernels& kernel = dense_kernels(Rounding::kFastest);
  for (const std::uint32_t s : path) {
    const Front& front = fronts_[s];
    solve_front_lower(kernel, front.width(), front.below(), front.l.data(), front.rows.data(),
                      x.data() + 6 * std::size_t{front.first}, x.data(), gathered_);
  }
  std::vector<std::uint32_t> open;
  for (const std::uint32_t s : path) {
    if (fronts_[s].parent < 0) open.push_back(s);
  }
  const auto matters = [&](std::uint32_t s) {
    if (on_path_[s] != 0) return true;
    return std::any_of(fronts_[s].rows.begin(), fronts_[s].rows.end(), [&](std::uint32_t row) {
      const double* value = x.data() + 6 * std::size_t{row};
      const double* sqrt_diagonal = sqrt_diagonals_.data() + 6 * std::size_t{row};
      for (int k = 0; k < 6; ++k) {
        if (std::abs(value[k]) * sqrt_diagonal[k] > tolerance) return true;
      }
      return false;
    });
  };
  while (!open.empty()) {
    const std::uint32_t s = open.back();
    open.pop_back();
    const Front& front = fronts_[s];
    solve_front_upper(kernel, front.width(), front.below(), front.l.data(), front.rows.data(),
                      x.data() + 6 * std::size_t{front.first}, x.data(), gathered_);
    for (std::uint32_t p = front.first; p < front.end; ++p) visited.push_back(p);
    std::copy_if(front.children.begin(), front.children.end(), std::back_inserter(open), matters);
  }
  for (const std::uint32_t s : path) on_path_[s] = 0;
}

}  // namespace loopwise::detail
