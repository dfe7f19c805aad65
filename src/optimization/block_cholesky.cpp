// SPDX-License-Identifier: BSD-3-Clause
#include "block_cholesky.hpp"

#include <cholmod.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <numeric>
#include <string>

#include <loopwise/core/error.hpp>

#include "blas_threads.hpp"

namespace loopwise::detail {
namespace {

/// For blocks that are not 6×6: the supernodal factorisation, with its dense panels, is faster above this
/// ratio of operations to non-zeros.
constexpr double kSupernodalFlopsPerNonzero = 40.0;

}  // namespace

struct BlockCholesky::Cholmod {
  cholmod_common common{};
  cholmod_factor* factor = nullptr;
  // Workspace that cholmod_solve2 keeps between calls.
  cholmod_dense *x = nullptr, *y = nullptr, *e = nullptr;

  Cholmod() {
    cholmod_start(&common);
    common.print = 0;
    common.error_handler = nullptr;
    common.try_catch = 1;
    common.quick_return_if_not_posdef = 1;
  }
  ~Cholmod() {
    release_factor();
    cholmod_free_dense(&x, &common);
    cholmod_free_dense(&y, &common);
    cholmod_free_dense(&e, &common);
    cholmod_finish(&common);
  }
  Cholmod(const Cholmod&) = delete;
  Cholmod& operator=(const Cholmod&) = delete;

  void release_factor() {
    if (factor != nullptr) cholmod_free_factor(&factor, &common);
  }

  /// CHOLMOD reports through a status; callers read warnings (> 0) where they matter.
  void check(const char* what) const {
    if (common.status >= CHOLMOD_OK) return;
    if (common.status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
    if (common.status == CHOLMOD_TOO_LARGE) {
      throw Error(std::string(what) + ": the factor is too large; too many long edges connect distant nodes");
    }
    throw Error(std::string(what) + ": CHOLMOD status " + std::to_string(common.status));
  }
};

namespace {

bool is_permutation(const std::vector<int>& p) {
  std::vector<char> seen(p.size(), 0);
  for (const int i : p) {
    if (i < 0 || static_cast<std::size_t>(i) >= p.size() || seen[static_cast<std::size_t>(i)] != 0)
      return false;
    seen[static_cast<std::size_t>(i)] = 1;
  }
  return true;
}

/// Presents a pattern or matrix in our memory as a CHOLMOD matrix.
cholmod_sparse view(std::size_t n, std::vector<int>& start, std::vector<int>& rows, double* values,
                    int stype) {
  cholmod_sparse a{};
  a.nrow = a.ncol = n;
  a.nzmax = rows.size();
  a.p = start.data();
  a.i = rows.data();
  a.x = values;
  a.stype = stype;
  a.itype = CHOLMOD_INT;
  a.xtype = values != nullptr ? CHOLMOD_REAL : CHOLMOD_PATTERN;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = 1;
  a.packed = 1;
  return a;
}

/// Sorts lexicographically by two passes of counting sort: the numbers are small and the pairs are many.
void sort_pairs(std::vector<BlockCholesky::Pair>& pairs, std::size_t n) {
  std::vector<BlockCholesky::Pair> sorted(pairs.size());
  std::vector<std::size_t> next(n + 1);
  const auto pass = [&](std::uint32_t BlockCholesky::Pair::*number) {
    std::fill(next.begin(), next.end(), 0);
    for (const auto& p : pairs) ++next[p.*number + 1];
    std::partial_sum(next.begin(), next.end(), next.begin());
    for (const auto& p : pairs) sorted[next[p.*number]++] = p;
    pairs.swap(sorted);
  };
  pass(&BlockCholesky::Pair::second);
  pass(&BlockCholesky::Pair::first);
}

}  // namespace

BlockCholesky::BlockCholesky(int block_size, Factorization factorization)
    : block_(block_size), choice_(factorization), cholmod_(std::make_unique<Cholmod>()) {
#ifndef LOOPWISE_WITH_GPL
  if (choice_ == Factorization::kSupernodal) {
    throw OptionError("factorization = \"supernodal\", but this build leaves out CHOLMOD's GPL parts");
  }
#endif
}

BlockCholesky::~BlockCholesky() = default;

void BlockCholesky::order(const std::vector<Pair>& upper) {
  const std::size_t n = variables_;
  Cholmod& c = *cholmod_;
  std::vector<int> start(n + 1, 0), rows(upper.size());
  for (const Pair& p : upper) ++start[p.second + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<int> next(start.begin(), start.end() - 1);
  for (const Pair& p : upper) rows[static_cast<std::size_t>(next[p.second]++)] = static_cast<int>(p.first);
  cholmod_sparse graph = view(n, start, rows, nullptr, 1);

  struct Ordering {
    std::vector<int> permutation, parent, post, counts;
    double flops = 0.0;
  };
  const auto evaluate = [&](int method) {
    Ordering o;
    o.permutation.resize(n);
    o.parent.resize(n);
    o.post.resize(n);
    o.counts.resize(n);
    std::vector<int> first(n), level(n);
    if (method == CHOLMOD_METIS) {
      cholmod_metis(&graph, nullptr, 0, 0, o.permutation.data(), &c.common);
      // METIS stops without an error if a signal to terminate reaches the process meanwhile.
      if (c.common.status != CHOLMOD_OK || !is_permutation(o.permutation)) {
        o.flops = std::numeric_limits<double>::infinity();
        return o;
      }
    } else {
      cholmod_amd(&graph, nullptr, 0, o.permutation.data(), &c.common);
      c.check("ordering");
    }
    cholmod_analyze_ordering(&graph, CHOLMOD_GIVEN, o.permutation.data(), nullptr, 0, o.parent.data(),
                             o.post.data(), o.counts.data(), first.data(), level.data(), &c.common);
    c.check("ordering");
    for (const int count : o.counts) o.flops += static_cast<double>(count) * count;
    return o;
  };
  Ordering best = evaluate(CHOLMOD_AMD);
  // Computing a nested dissection costs more than it saves, unless the factorisation is long.
  const double b = block_;
  if (best.flops * b * b * b > 2e9) {
    Ordering other = evaluate(CHOLMOD_METIS);
    if (other.flops < best.flops) best = std::move(other);
  }

  position_.resize(n);
  block_parent_.assign(n, -1);
  block_count_.resize(n);
  std::vector<int> rank(n);  // of a column of the ordering in the postorder
  for (std::size_t k = 0; k < n; ++k) rank[static_cast<std::size_t>(best.post[k])] = static_cast<int>(k);
  for (std::size_t k = 0; k < n; ++k) {
    const auto column = static_cast<std::size_t>(best.post[k]);
    position_[static_cast<std::size_t>(best.permutation[column])] = static_cast<std::uint32_t>(k);
    block_count_[k] = best.counts[column];
    if (best.parent[column] >= 0) block_parent_[k] = rank[static_cast<std::size_t>(best.parent[column])];
  }
  factor_flops_ = factor_nonzeros_ = 0.0;
  for (const int count : block_count_) {
    for (int k = 0; k < block_; ++k) {
      const double column = b * count - k;
      factor_nonzeros_ += column;
      factor_flops_ += column * column;
    }
  }
}

void BlockCholesky::choose() {
  chosen_ = choice_;
  if (block_ == 6 && chosen_ == Factorization::kAutomatic) chosen_ = Factorization::kMultifrontal;
  if (block_ == 6 || (chosen_ != Factorization::kAutomatic && chosen_ != Factorization::kMultifrontal))
    return;
  chosen_ = Factorization::kSimplicial;
#ifdef LOOPWISE_WITH_GPL
  if (factor_flops_ > kSupernodalFlopsPerNonzero * factor_nonzeros_) chosen_ = Factorization::kSupernodal;
#endif
}

BlockPattern BlockCholesky::pattern(const std::vector<Pair>& upper, bool lower) const {
  // Visiting the rows in order leaves every column sorted.
  const std::size_t n = variables_;
  const auto transpose = [n](const BlockPattern& rows) {
    BlockPattern columns;
    columns.start.assign(n + 1, 0);
    columns.rows.resize(rows.rows.size());
    for (const std::uint32_t c : rows.rows) ++columns.start[c + 1];
    std::partial_sum(columns.start.begin(), columns.start.end(), columns.start.begin());
    std::vector<std::size_t> next(columns.start.begin(), columns.start.end() - 1);
    for (std::uint32_t r = 0; r < n; ++r) {
      for (std::size_t p = rows.start[r]; p < rows.start[r + 1]; ++p) columns.rows[next[rows.rows[p]]++] = r;
    }
    return columns;
  };
  BlockPattern unsorted;  // by row of the requested triangle
  unsorted.start.assign(n + 1, 0);
  unsorted.rows.resize(upper.size());
  const auto row_and_column = [&](const Pair& p) {
    const auto [small, large] = std::minmax(position_[p.first], position_[p.second]);
    return lower ? Pair(large, small) : Pair(small, large);
  };
  for (const Pair& p : upper) ++unsorted.start[row_and_column(p).first + 1];
  std::partial_sum(unsorted.start.begin(), unsorted.start.end(), unsorted.start.begin());
  std::vector<std::size_t> next(unsorted.start.begin(), unsorted.start.end() - 1);
  for (const Pair& p : upper) {
    const Pair place = row_and_column(p);
    unsorted.rows[next[place.first]++] = place.second;
  }
  return transpose(unsorted);
}

void BlockCholesky::lay_out(const BlockPattern& columns, bool lower) {
  const std::size_t n = variables_;
  const auto block = static_cast<std::size_t>(block_);
  if (columns.rows.size() * block * block > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    throw Error("the graph has too many edges for one factorisation");
  }
  values_.assign(columns.rows.size() * block * block, 0.0);
  // CHOLMOD needs scalar columns; the fronts need one block after the other.
  const bool blocks = chosen_ == Factorization::kMultifrontal;
  const auto slot = [&](std::uint32_t row, std::uint32_t column) {
    const auto begin = columns.rows.begin() + static_cast<std::ptrdiff_t>(columns.start[column]);
    const auto end = columns.rows.begin() + static_cast<std::ptrdiff_t>(columns.start[column + 1]);
    const auto index = static_cast<std::size_t>(std::lower_bound(begin, end, row) - begin);
    Slot s;
    s.offset = block * block * columns.start[column] + index * (blocks ? block * block : block);
    s.stride = static_cast<std::uint32_t>(blocks ? block : static_cast<std::size_t>(end - begin) * block);
    return s;
  };
  diagonal_slots_.resize(n);
  for (std::size_t v = 0; v < n; ++v) diagonal_slots_[v] = slot(position_[v], position_[v]);
  for (std::size_t k = 0; k < pair_slots_.size(); ++k) {
    const std::uint32_t a = position_[pairs_[k].first], b = position_[pairs_[k].second];
    const bool in_order = lower ? a > b : a < b;
    pair_slots_[k] = in_order ? slot(a, b) : slot(b, a);
    pair_slots_[k].transposed = !in_order;
    pair_columns_[k] = in_order ? b : a;
  }
}

void BlockCholesky::lay_out_scalars(const BlockPattern& columns) {
  const auto block = static_cast<std::size_t>(block_);
  row_index_.resize(values_.size());
  column_start_.assign(variables_ * block + 1, 0);
  std::size_t at = 0;
  for (std::size_t v = 0; v < variables_; ++v) {
    for (std::size_t c = 0; c < block; ++c) {
      column_start_[v * block + c] = static_cast<int>(at);
      for (std::size_t p = columns.start[v]; p < columns.start[v + 1]; ++p) {
        for (std::size_t r = 0; r < block; ++r)
          row_index_[at++] = static_cast<int>(columns.rows[p] * block + r);
      }
    }
  }
  column_start_.back() = static_cast<int>(at);
}

void BlockCholesky::analyze(std::size_t variables, const std::vector<Pair>& pairs) {
  const SingleThreadedBlas guard;
  Cholmod& c = *cholmod_;
  c.release_factor();
  fronts_.reset();
  variables_ = variables;
  pairs_ = pairs;
  pair_slots_.assign(pairs.size(), {});
  pair_columns_.assign(pairs.size(), 0);
  std::vector<Pair> upper = pairs;
  for (Pair& p : upper) {
    if (p.first > p.second) std::swap(p.first, p.second);
  }
  sort_pairs(upper, variables);
  upper.erase(std::unique(upper.begin(), upper.end()), upper.end());
  for (std::uint32_t v = 0; v < variables; ++v) upper.emplace_back(v, v);

  if (variables == 0) return;
  if (variables * static_cast<std::size_t>(block_) >
      static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    throw Error("the graph has too many nodes for one factorisation");
  }
  order(upper);
  choose();
  // Supernodal CHOLMOD and the fronts read the lower triangle, simplicial CHOLMOD the upper one.
  const bool lower = chosen_ != Factorization::kSimplicial;
  const BlockPattern columns = pattern(upper, lower);
  lay_out(columns, lower);
  if (chosen_ == Factorization::kMultifrontal) {
    fronts_ = std::make_unique<MultifrontalCholesky>(columns, block_parent_, block_count_);
    return;
  }
  lay_out_scalars(columns);
  make_symbolic_factor();
}

void BlockCholesky::make_symbolic_factor() {
  // The results of cholmod_analyze for the scalar matrix follow from the graph of blocks, which is six times
  // smaller.
  Cholmod& c = *cholmod_;
  const std::size_t n = variables_ * static_cast<std::size_t>(block_);
  c.factor = cholmod_allocate_factor(n, &c.common);
  c.check("symbolic analysis");
  c.factor->ordering = CHOLMOD_NATURAL;
  auto* counts = static_cast<int*>(c.factor->ColCount);
  for (std::size_t v = 0; v < variables_; ++v) {
    for (int k = 0; k < block_; ++k) *counts++ = block_ * block_count_[v] - k;
  }
#ifdef LOOPWISE_WITH_GPL
  if (chosen_ != Factorization::kSupernodal) return;
  std::vector<int> parent(n);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t v = i / static_cast<std::size_t>(block_);
    const bool last = (i + 1) % static_cast<std::size_t>(block_) == 0;
    parent[i] = !last ? static_cast<int>(i + 1) : block_parent_[v] < 0 ? -1 : block_ * block_parent_[v];
  }
  // The supernodal analysis reads the upper triangle of the pattern. All columns of a block have the same
  // rows, so it needs the rows of one column only, but it expects an entry for every column.
  std::vector<int> start(n + 1, 0), rows(row_index_.size());
  const std::size_t block = static_cast<std::size_t>(block_);
  for (std::size_t v = 0; v < variables_; ++v) {
    for (int p = column_start_[v * block]; p < column_start_[v * block + 1]; ++p) {
      start[static_cast<std::size_t>(row_index_[static_cast<std::size_t>(p)]) + 1] += block_;
    }
  }
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<int> next(start.begin(), start.end() - 1);
  for (std::size_t v = 0; v < variables_; ++v) {
    for (int p = column_start_[v * block]; p < column_start_[v * block + 1]; ++p) {
      int& at = next[static_cast<std::size_t>(row_index_[static_cast<std::size_t>(p)])];
      for (std::size_t k = 0; k < block; ++k)
        rows[static_cast<std::size_t>(at++)] = static_cast<int>(v * block + k);
    }
  }
  cholmod_sparse upper = view(n, start, rows, nullptr, 1);
  cholmod_super_symbolic(&upper, nullptr, parent.data(), c.factor, &c.common);
  c.check("symbolic analysis");
#endif
}

void BlockCholesky::set_zero() {
  std::fill(values_.begin(), values_.end(), 0.0);
}

Eigen::VectorXd BlockCholesky::diagonal() const {
  Eigen::VectorXd d(static_cast<Eigen::Index>(variables_) * block_);
  for (std::size_t v = 0; v < variables_; ++v) {
    const Slot& slot = diagonal_slots_[v];
    for (int k = 0; k < block_; ++k) {
      d[static_cast<Eigen::Index>(v) * block_ + k] =
          values_[slot.offset + static_cast<std::size_t>(k) * (slot.stride + 1)];
    }
  }
  return d;
}

void BlockCholesky::set_diagonal(const Eigen::VectorXd& diagonal) {
  for (std::size_t v = 0; v < variables_; ++v) {
    const Slot& slot = diagonal_slots_[v];
    for (int k = 0; k < block_; ++k) {
      values_[slot.offset + static_cast<std::size_t>(k) * (slot.stride + 1)] =
          diagonal[static_cast<Eigen::Index>(v) * block_ + k];
    }
  }
}

bool BlockCholesky::factorize(ThreadPool* pool) {
  if (variables_ == 0) return true;
  const SingleThreadedBlas guard;
  if (fronts_) return fronts_->factorize(values_.data(), pool);
  Cholmod& c = *cholmod_;
  const std::size_t n = variables_ * static_cast<std::size_t>(block_);
  cholmod_sparse a =
      view(n, column_start_, row_index_, values_.data(), chosen_ == Factorization::kSupernodal ? -1 : 1);
  cholmod_factorize(&a, c.factor, &c.common);
  c.check("factorisation");
  if (c.common.status == CHOLMOD_NOT_POSDEF || c.factor->minor < n) return false;
  return true;
}

std::vector<double> BlockCholesky::cholmod_pivots() const {
  const cholmod_factor& f = *cholmod_->factor;
  const auto* x = static_cast<const double*>(f.x);
  std::vector<double> pivots(f.n, 0.0);
  if (f.is_super) {
    const auto* super = static_cast<const int*>(f.super);
    const auto* pi = static_cast<const int*>(f.pi);
    const auto* px = static_cast<const int*>(f.px);
    for (std::size_t s = 0; s < f.nsuper; ++s) {
      const auto height = static_cast<std::size_t>(pi[s + 1] - pi[s]);
      for (std::size_t j = 0; j < static_cast<std::size_t>(super[s + 1] - super[s]); ++j) {
        const double l = x[static_cast<std::size_t>(px[s]) + j * (height + 1)];
        pivots[static_cast<std::size_t>(super[s]) + j] = l > 0.0 ? l * l : 0.0;
      }
    }
  } else {
    const auto* p = static_cast<const int*>(f.p);
    for (std::size_t j = 0; j < pivots.size(); ++j) {
      const double l = x[static_cast<std::size_t>(p[j])];
      pivots[j] = f.is_ll ? (l > 0.0 ? l * l : 0.0) : l;
    }
  }
  return pivots;
}

std::pair<double, std::size_t> BlockCholesky::smallest_pivot() const {
  const auto block = static_cast<std::size_t>(block_);
  const std::size_t broken = fronts_ ? fronts_->broken_at() : cholmod_->factor->minor / block;
  if (broken < variables_) {
    const auto found = std::find(position_.begin(), position_.end(), static_cast<std::uint32_t>(broken));
    return {0.0, static_cast<std::size_t>(found - position_.begin())};
  }
  const Eigen::VectorXd d = diagonal();
  const std::vector<double> pivots = fronts_ ? fronts_->pivots() : cholmod_pivots();
  std::pair<double, std::size_t> smallest{1.0, 0};
  for (std::size_t v = 0; v < variables_; ++v) {
    for (std::size_t k = 0; k < block; ++k) {
      const double pivot = pivots[position_[v] * block + k];
      const double ratio = pivot > 0.0 ? pivot / d[static_cast<Eigen::Index>(v * block + k)] : 0.0;
      if (!(ratio >= smallest.first)) smallest = {std::isnan(ratio) ? 0.0 : ratio, v};
    }
  }
  return smallest;
}

void BlockCholesky::solve(Eigen::VectorXd& x) const {
  if (variables_ == 0) return;
  if (!fronts_) {
    Eigen::MatrixXd m = x;
    solve(m);
    x = m;
    return;
  }
  Eigen::VectorXd y(x.size());
  for (std::size_t v = 0; v < variables_; ++v) {
    y.segment<6>(6 * static_cast<Eigen::Index>(position_[v])) =
        x.segment<6>(6 * static_cast<Eigen::Index>(v));
  }
  fronts_->solve(y.data());
  for (std::size_t v = 0; v < variables_; ++v) {
    x.segment<6>(6 * static_cast<Eigen::Index>(v)) =
        y.segment<6>(6 * static_cast<Eigen::Index>(position_[v]));
  }
}

Eigen::MatrixXd BlockCholesky::inverse_between(const Eigen::MatrixXd& b) const {
  if (!fronts_) {
    Eigen::MatrixXd solved = b;
    solve(solved);
    return b.transpose() * solved;
  }
  Eigen::MatrixXd y(b.rows(), b.cols());
  for (std::size_t v = 0; v < variables_; ++v) {
    y.middleRows<6>(6 * static_cast<Eigen::Index>(position_[v])) =
        b.middleRows<6>(6 * static_cast<Eigen::Index>(v));
  }
  for (Eigen::Index c = 0; c < y.cols(); ++c) fronts_->solve_lower(y.col(c).data());
  return y.transpose() * y;
}

void BlockCholesky::solve(Eigen::MatrixXd& x) const {
  if (variables_ == 0 || x.cols() == 0) return;
  if (fronts_) {
    for (Eigen::Index c = 0; c < x.cols(); ++c) {
      Eigen::VectorXd column = x.col(c);
      solve(column);
      x.col(c) = column;
    }
    return;
  }
  const SingleThreadedBlas guard;
  Cholmod& c = *cholmod_;
  Eigen::MatrixXd permuted(x.rows(), x.cols());
  for (std::size_t v = 0; v < variables_; ++v) {
    permuted.middleRows(static_cast<Eigen::Index>(position_[v]) * block_, block_) =
        x.middleRows(static_cast<Eigen::Index>(v) * block_, block_);
  }
  cholmod_dense b{};
  b.nrow = b.d = static_cast<std::size_t>(x.rows());
  b.ncol = static_cast<std::size_t>(x.cols());
  b.nzmax = b.nrow * b.ncol;
  b.x = permuted.data();
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  cholmod_solve2(CHOLMOD_A, c.factor, &b, nullptr, &c.x, nullptr, &c.y, &c.e, &c.common);
  c.check("solve");
  const Eigen::Map<const Eigen::MatrixXd> solution(static_cast<const double*>(c.x->x), x.rows(), x.cols());
  for (std::size_t v = 0; v < variables_; ++v) {
    x.middleRows(static_cast<Eigen::Index>(v) * block_, block_) =
        solution.middleRows(static_cast<Eigen::Index>(position_[v]) * block_, block_);
  }
}

double BlockCholesky::log_determinant() const {
  if (variables_ == 0) return 0.0;
  const Panels p = panels();
  double sum = 0.0;
  for (std::size_t s = 0; s < p.size(); ++s) {
    const auto height = static_cast<std::size_t>(p.height(s));
    for (std::size_t j = 0; j < static_cast<std::size_t>(p.columns(s)); ++j) {
      sum += 2.0 * std::log(p.values[p.value_start[s] + j * (height + 1)]);
    }
  }
  return sum;
}

Panels BlockCholesky::panels() const {
  Panels out;
  if (variables_ == 0) return out;
  if (fronts_) return fronts_->panels();
  const cholmod_factor& f = *cholmod_->factor;
  const auto* x = static_cast<const double*>(f.x);
  if (f.is_super) {
    const auto* super = static_cast<const int*>(f.super);
    const auto* pi = static_cast<const int*>(f.pi);
    const auto* px = static_cast<const int*>(f.px);
    out.first.assign(super, super + f.nsuper + 1);
    out.row_start.assign(pi, pi + f.nsuper + 1);
    out.value_start.assign(px, px + f.nsuper + 1);
    out.rows.assign(static_cast<const int*>(f.s), static_cast<const int*>(f.s) + f.ssize);
    out.values.assign(x, x + f.xsize);
    return out;
  }
  // Simplicial L·D·Lᵀ (or L·Lᵀ): a column shares a panel with its left neighbour if it continues that
  // column's pattern.
  const auto* p = static_cast<const int*>(f.p);
  const auto* nz = static_cast<const int*>(f.nz);
  const auto* rows = static_cast<const int*>(f.i);
  const auto n = static_cast<int>(f.n);
  std::vector<int> children(f.n, 0);
  const auto count = [&](int j) { return nz[j]; };
  const auto parent = [&](int j) { return count(j) > 1 ? rows[p[j] + 1] : -1; };
  for (int j = 0; j < n; ++j) {
    if (parent(j) >= 0) ++children[static_cast<std::size_t>(parent(j))];
  }
  out.first.push_back(0);
  for (int j = 1; j < n; ++j) {
    const bool continues =
        parent(j - 1) == j && count(j - 1) == count(j) + 1 && children[static_cast<std::size_t>(j)] == 1;
    if (!continues) out.first.push_back(j);
  }
  out.first.push_back(n);
  out.row_start.push_back(0);
  out.value_start.push_back(0);
  for (std::size_t s = 0; s + 1 < out.first.size(); ++s) {
    const int j0 = out.first[s], width = out.first[s + 1] - j0;
    const auto height = static_cast<std::size_t>(count(j0));
    out.rows.insert(out.rows.end(), rows + p[j0], rows + p[j0] + count(j0));
    const std::size_t base = out.values.size();
    out.values.resize(base + height * static_cast<std::size_t>(width), 0.0);
    for (int j = 0; j < width; ++j) {
      const double* column = x + p[j0 + j];
      const double pivot = f.is_ll ? column[0] : std::sqrt(column[0]);
      double* to = out.values.data() + base + static_cast<std::size_t>(j) * (height + 1);
      to[0] = pivot;
      for (int k = 1; k < count(j0 + j); ++k) to[k] = f.is_ll ? column[k] : column[k] * pivot;
    }
    out.row_start.push_back(out.rows.size());
    out.value_start.push_back(out.values.size());
  }
  return out;
}

Panels BlockCholesky::take_panels() {
  return fronts_ ? fronts_->take_panels() : panels();
}

}  // namespace loopwise::detail
