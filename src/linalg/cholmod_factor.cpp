// SPDX-License-Identifier: BSD-3-Clause
#include "cholmod_factor.hpp"

#include <cholmod.h>

#include <algorithm>
#include <cmath>
#include <new>
#include <numeric>
#include <string>

#include <loopwise/core/error.hpp>

namespace loopwise::detail {
namespace {

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

}  // namespace

struct CholmodFactor::Workspace {
  cholmod_common common{};
  cholmod_factor* factor = nullptr;
  // Workspace that cholmod_solve2 keeps between calls.
  cholmod_dense *x = nullptr, *y = nullptr, *e = nullptr;

  Workspace() {
    cholmod_start(&common);
    common.print = 0;
    common.error_handler = nullptr;
    common.try_catch = 1;
    common.quick_return_if_not_posdef = 1;
  }
  ~Workspace() {
    if (factor != nullptr) cholmod_free_factor(&factor, &common);
    cholmod_free_dense(&x, &common);
    cholmod_free_dense(&y, &common);
    cholmod_free_dense(&e, &common);
    cholmod_finish(&common);
  }
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

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

CholmodFactor::CholmodFactor(int block_size, bool supernodal, const BlockPattern& pattern,
                             const Elimination& elimination)
    : block_(block_size),
      supernodal_(supernodal),
      variables_(pattern.columns()),
      workspace_(std::make_unique<Workspace>()) {
  lay_out(pattern);
  make_symbolic_factor(elimination);
}

CholmodFactor::~CholmodFactor() = default;

void CholmodFactor::lay_out(const BlockPattern& pattern) {
  const auto block = static_cast<std::size_t>(block_);
  row_index_.resize(pattern.rows.size() * block * block);
  column_start_.assign(variables_ * block + 1, 0);
  std::size_t at = 0;
  for (std::size_t v = 0; v < variables_; ++v) {
    for (std::size_t c = 0; c < block; ++c) {
      column_start_[v * block + c] = static_cast<int>(at);
      for (std::size_t p = pattern.start[v]; p < pattern.start[v + 1]; ++p) {
        for (std::size_t r = 0; r < block; ++r)
          row_index_[at++] = static_cast<int>(pattern.rows[p] * block + r);
      }
    }
  }
  column_start_.back() = static_cast<int>(at);
}

void CholmodFactor::make_symbolic_factor(const Elimination& elimination) {
  // The results of cholmod_analyze for the scalar matrix follow from the graph of blocks, which is many times
  // smaller.
  Workspace& c = *workspace_;
  const std::size_t n = variables_ * static_cast<std::size_t>(block_);
  c.factor = cholmod_allocate_factor(n, &c.common);
  c.check("symbolic analysis");
  c.factor->ordering = CHOLMOD_NATURAL;
  auto* counts = static_cast<int*>(c.factor->ColCount);
  for (std::size_t v = 0; v < variables_; ++v) {
    for (int k = 0; k < block_; ++k) *counts++ = block_ * elimination.count[v] - k;
  }
#ifdef LOOPWISE_WITH_GPL
  if (!supernodal_) return;
  std::vector<int> parent(n);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t v = i / static_cast<std::size_t>(block_);
    const bool last = (i + 1) % static_cast<std::size_t>(block_) == 0;
    parent[i] = !last                       ? static_cast<int>(i + 1)
                : elimination.parent[v] < 0 ? -1
                                            : block_ * elimination.parent[v];
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

bool CholmodFactor::factorize(std::vector<double>& values) {
  Workspace& c = *workspace_;
  const std::size_t n = variables_ * static_cast<std::size_t>(block_);
  cholmod_sparse a = view(n, column_start_, row_index_, values.data(), supernodal_ ? -1 : 1);
  cholmod_factorize(&a, c.factor, &c.common);
  c.check("factorisation");
  return c.common.status != CHOLMOD_NOT_POSDEF && c.factor->minor >= n;
}

std::size_t CholmodFactor::broken_at() const {
  return workspace_->factor->minor / static_cast<std::size_t>(block_);
}

std::vector<double> CholmodFactor::pivots() const {
  const cholmod_factor& f = *workspace_->factor;
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

void CholmodFactor::solve(Eigen::MatrixXd& x) {
  Workspace& c = *workspace_;
  cholmod_dense b{};
  b.nrow = b.d = static_cast<std::size_t>(x.rows());
  b.ncol = static_cast<std::size_t>(x.cols());
  b.nzmax = b.nrow * b.ncol;
  b.x = x.data();
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  cholmod_solve2(CHOLMOD_A, c.factor, &b, nullptr, &c.x, nullptr, &c.y, &c.e, &c.common);
  c.check("solve");
  x = Eigen::Map<const Eigen::MatrixXd>(static_cast<const double*>(c.x->x), x.rows(), x.cols());
}

Panels CholmodFactor::panels() const {
  Panels out;
  if (workspace_->factor->is_super) {
    copy_supernodes(out);
  } else {
    copy_columns(out);
  }
  out.owner.resize(variables_);
  for (std::size_t s = 0; s < out.size(); ++s) {
    std::fill(out.owner.begin() + out.first[s], out.owner.begin() + out.first[s + 1],
              static_cast<std::uint32_t>(s));
  }
  for (std::size_t s = 0; s < out.size(); ++s) {
    const bool root = out.row_start[s + 1] == out.row_start[s];
    out.parent.push_back(root ? -1 : static_cast<int>(out.owner[out.rows[out.row_start[s]]]));
  }
  return out;
}

void CholmodFactor::copy_supernodes(Panels& out) const {
  const cholmod_factor& f = *workspace_->factor;
  const auto* super = static_cast<const int*>(f.super);
  const auto* pi = static_cast<const int*>(f.pi);
  const auto* px = static_cast<const int*>(f.px);
  const auto* rows = static_cast<const int*>(f.s);
  const auto* x = static_cast<const double*>(f.x);
  // A supernode never splits a block: all columns of a block have the same pattern.
  for (std::size_t s = 0; s <= f.nsuper; ++s) out.first.push_back(static_cast<std::uint32_t>(super[s] / 6));
  for (std::size_t s = 0; s < f.nsuper; ++s) {
    for (int p = pi[s] + super[s + 1] - super[s]; p < pi[s + 1]; p += 6) {
      out.rows.push_back(static_cast<std::uint32_t>(rows[p] / 6));
    }
    out.row_start.push_back(out.rows.size());
  }
  out.value_start.assign(px, px + f.nsuper + 1);
  out.values.assign(x, x + f.xsize);
}

/// L·D·Lᵀ (or L·Lᵀ) by columns. A block column shares a panel with its left neighbour if it continues that
/// column's pattern.
void CholmodFactor::copy_columns(Panels& out) const {
  const cholmod_factor& f = *workspace_->factor;
  const auto* p = static_cast<const int*>(f.p);
  const auto* nz = static_cast<const int*>(f.nz);
  const auto* rows = static_cast<const int*>(f.i);
  const auto* x = static_cast<const double*>(f.x);
  const auto blocks = [&](std::size_t v) { return nz[6 * v] / 6; };
  const auto parent = [&](std::size_t v) {
    return blocks(v) > 1 ? static_cast<std::size_t>(rows[p[6 * v] + 6] / 6) : variables_;
  };
  std::vector<int> children(variables_ + 1, 0);
  for (std::size_t v = 0; v < variables_; ++v) ++children[parent(v)];
  for (std::size_t v = 0; v < variables_; ++v) {
    const bool continues = v > 0 && parent(v - 1) == v && blocks(v - 1) == blocks(v) + 1 && children[v] == 1;
    if (!continues) out.first.push_back(static_cast<std::uint32_t>(v));
  }
  out.first.push_back(static_cast<std::uint32_t>(variables_));
  for (std::size_t s = 0; s < out.size(); ++s) {
    const std::size_t first = out.first[s], width = 6 * (out.first[s + 1] - first);
    const auto height = static_cast<std::size_t>(nz[6 * first]);
    for (std::size_t r = width; r < height; r += 6) {
      out.rows.push_back(static_cast<std::uint32_t>(rows[static_cast<std::size_t>(p[6 * first]) + r] / 6));
    }
    const std::size_t base = out.values.size();
    out.values.resize(base + height * width, 0.0);
    for (std::size_t j = 0; j < width; ++j) {
      const double* column = x + p[6 * first + j];
      const double pivot = f.is_ll ? column[0] : std::sqrt(column[0]);
      double* to = out.values.data() + base + j * (height + 1);
      to[0] = pivot;
      for (int k = 1; k < nz[6 * first + j]; ++k) to[k] = f.is_ll ? column[k] : column[k] * pivot;
    }
    out.row_start.push_back(out.rows.size());
    out.value_start.push_back(out.values.size());
  }
}

}  // namespace loopwise::detail
