// SPDX-License-Identifier: BSD-3-Clause
#include "closure_factor.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/optimization/auxiliary_factors.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/optimization/ordering.hpp>

namespace loopwise::detail {
namespace {

/// A pivot below this share of the matrix's diagonal is a rounding error: the pose is undetermined.
constexpr double kSingularPivot = 1e-14;
/// A new order of elimination is computed when the factorisation costs this many times as much as after the
/// last one.
constexpr double kReorderGrowth = 1.25;
constexpr std::size_t kBlock = 36;

using Block = Eigen::Map<Matrix6d>;
using ConstBlock = Eigen::Map<const Matrix6d>;

/// C −= A·Bᵀ; all matrices are 6×6 and column-major.
inline void subtract_abt(const double* __restrict a, const double* __restrict b, double* __restrict c) {
  for (int j = 0; j < 6; ++j) {
    double sum[6];
    for (int i = 0; i < 6; ++i) sum[i] = c[6 * j + i];
    for (int k = 0; k < 6; ++k) {
      const double f = b[6 * k + j];
      for (int i = 0; i < 6; ++i) sum[i] -= a[6 * k + i] * f;
    }
    for (int i = 0; i < 6; ++i) c[6 * j + i] = sum[i];
  }
}

/// Lower Cholesky factor of the block in place (zeros above), and its inverse. \returns false if the block is
/// not positive definite.
bool factorize_block(double* l, double* inverse) {
  for (int j = 0; j < 6; ++j) {
    const double original = l[7 * j];
    double d = original;
    for (int k = 0; k < j; ++k) d -= l[6 * k + j] * l[6 * k + j];
    if (!(d > 0.0)) return false;
    const double root = std::sqrt(d);
    l[7 * j] = root;
    for (int i = j + 1; i < 6; ++i) {
      double s = l[6 * j + i];
      for (int k = 0; k < j; ++k) s -= l[6 * k + i] * l[6 * k + j];
      l[6 * j + i] = s / root;
    }
    for (int i = 0; i < j; ++i) l[6 * j + i] = 0.0;
  }
  std::fill_n(inverse, kBlock, 0.0);
  for (int j = 0; j < 6; ++j) {
    inverse[7 * j] = 1.0 / l[7 * j];
    for (int i = j + 1; i < 6; ++i) {
      double s = 0.0;
      for (int k = j; k < i; ++k) s -= l[6 * k + i] * inverse[6 * j + k];
      inverse[6 * j + i] = s / l[7 * i];
    }
  }
  return true;
}

}  // namespace

GraphComponents::GraphComponents(const PoseGraph& graph) {
  const std::size_t n = graph.nodes().size();
  DisjointSets sets(n);
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    if (graph.edges()[e].weight > 0.0) sets.join(graph.ends(e).from, graph.ends(e).to);
  }
  component.resize(n);
  std::uint32_t count = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t root = sets.root(i);
    component[i] = root == i ? count++ : component[root];
  }
  anchored.assign(count, false);
  for (const PriorFactor& prior : graph.priors()) anchored[component[graph.index_of(prior.key)]] = true;
}

ClosureFactor::ClosureFactor(const PoseGraph& graph) {
  if (graph.planar()) {
    throw InputError(
        "a 2D graph, but candidates are found and registered in 3D: only optimize, evaluate, info and "
        "convert "
        "support it");
  }
  const std::size_t n = graph.nodes().size();
  const GraphComponents parts(graph);
  std::vector<bool> has_factor(n, false);
  for (const PriorFactor& prior : graph.priors()) has_factor[graph.index_of(prior.key)] = true;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    if (graph.edges()[e].weight > 0.0) has_factor[graph.ends(e).from] = has_factor[graph.ends(e).to] = true;
  }
  std::vector<bool> seen(parts.anchored.size(), false);
  variable_.assign(n, kHeld);
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t part = parts.component[i];
    const bool first = !seen[part];
    seen[part] = true;
    if (!has_factor[i] || (first && !parts.anchored[part])) continue;
    variable_[i] = static_cast<std::uint32_t>(variables_++);
    keys_.push_back(graph.nodes()[i].key);
  }

  diagonal_.assign(variables_, Matrix6d::Zero());
  for (const PriorFactor& prior : graph.priors()) {
    const std::size_t node = graph.index_of(prior.key);
    if (held(node)) continue;
    const Vector6d r = se3::log(prior.pose.inverse() * graph.nodes()[node].pose);
    const Matrix6d J = se3::right_jacobian_inverse(r);
    diagonal_[variable_[node]] += J.transpose() * prior.information * J;
  }
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    if (edge.weight <= 0.0) continue;
    const auto [from, to] = graph.ends(e);
    const Eigen::Isometry3d &T_from = graph.nodes()[from].pose, &T_to = graph.nodes()[to].pose;
    const Matrix6d J_to = se3::right_jacobian_inverse(edge_residual(edge, T_from, T_to));
    const Matrix6d J_from = -J_to * se3::adjoint(T_to.inverse() * T_from);
    const Matrix6d information = edge.weight * edge.information;
    const std::uint32_t a = variable_[from], b = variable_[to];
    if (a != kHeld) diagonal_[a] += J_from.transpose() * information * J_from;
    if (b != kHeld) diagonal_[b] += J_to.transpose() * information * J_to;
    if (a != kHeld && b != kHeld) pairs_.push_back({a, b, J_from.transpose() * information * J_to});
  }
  for (const RangeFactor& range : graph.ranges()) {
    const std::size_t from = graph.index_of(range.from), to = graph.index_of(range.to);
    const LinearizedRange l = linearize(range, graph.nodes()[from].pose, graph.nodes()[to].pose);
    const std::uint32_t a = variable_[from], b = variable_[to];
    if (a != kHeld) diagonal_[a] += l.J_from.transpose() * l.J_from;
    if (b != kHeld) diagonal_[b] += l.J_to.transpose() * l.J_to;
    if (a != kHeld && b != kHeld) pairs_.push_back({a, b, l.J_from.transpose() * l.J_to});
  }
  for (const GravityFactor& gravity : graph.gravities()) {
    const std::size_t node = graph.index_of(gravity.key);
    if (held(node)) continue;
    const LinearizedGravity l = linearize(gravity, graph.nodes()[node].pose);
    diagonal_[variable_[node]] += l.J.transpose() * l.J;
  }
  for (const Matrix6d& block : diagonal_) {
    if (!block.allFinite()) throw InputError("the Hessian at the poses is not finite");
  }
}

void ClosureFactor::analyze(const std::vector<const ClosureTerm*>& closures, bool reorder) {
  const std::size_t n = variables_;
  if (reorder) {
    std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;
    edges.reserve(pairs_.size() + closures.size());
    for (const Pair& pair : pairs_) edges.emplace_back(pair.a, pair.b);
    for (const ClosureTerm* c : closures) {
      if (!held(c->from) && !held(c->to)) edges.emplace_back(variable_[c->from], variable_[c->to]);
    }
    order_ = elimination_order(n, edges);
    position_.resize(n);
    for (std::size_t k = 0; k < n; ++k) position_[order_[k]] = static_cast<std::uint32_t>(k);
  }
  // Patterns of the columns of H below the diagonal, then of L. The pattern of a column of L is that of H
  // joined with those of its children in the elimination tree.
  columns_.resize(n);
  below_.resize(n);
  for (std::size_t k = 0; k < n; ++k) {
    columns_[k].clear();
    below_[k].clear();  // children
  }
  const auto add = [&](std::uint32_t a, std::uint32_t b) {
    const std::uint32_t p = position_[a], q = position_[b];
    if (p != q) columns_[std::min(p, q)].push_back(std::max(p, q));
  };
  for (const Pair& pair : pairs_) add(pair.a, pair.b);
  for (const ClosureTerm* c : closures) {
    if (!held(c->from) && !held(c->to)) add(variable_[c->from], variable_[c->to]);
  }
  mark_.assign(n, UINT32_MAX);
  parent_.resize(n);
  start_.resize(n + 1);
  rows_.clear();
  work_ = 0.0;
  for (std::uint32_t k = 0; k < n; ++k) {
    start_[k] = rows_.size();
    rows_.push_back(k);
    mark_[k] = k;
    const auto take = [&](std::uint32_t row) {
      if (mark_[row] == k) return;
      mark_[row] = k;
      rows_.push_back(row);
    };
    for (const std::uint32_t row : columns_[k]) take(row);
    for (const std::uint32_t child : below_[k]) {
      for (std::size_t p = start_[child] + 1; p < start_[child + 1]; ++p) take(rows_[p]);
    }
    std::sort(rows_.begin() + static_cast<std::ptrdiff_t>(start_[k]) + 1, rows_.end());
    start_[k + 1] = rows_.size();
    const std::size_t count = rows_.size() - start_[k];
    parent_[k] = count > 1 ? rows_[start_[k] + 1] : k;
    if (count > 1) below_[parent_[k]].push_back(k);
    work_ += static_cast<double>(count) * static_cast<double>(count);
  }
  if (reorder) ordered_work_ = work_;
}

std::size_t ClosureFactor::slot(std::uint32_t row, std::uint32_t column) const {
  const auto first = rows_.begin() + static_cast<std::ptrdiff_t>(start_[column]);
  const auto last = rows_.begin() + static_cast<std::ptrdiff_t>(start_[column + 1]);
  return static_cast<std::size_t>(std::lower_bound(first, last, row) - rows_.begin());
}

void ClosureFactor::add_block(std::uint32_t a, std::uint32_t b, const Matrix6d& block) {
  const std::uint32_t p = position_[a], q = position_[b];
  if (p >= q) {
    Block(values_.data() + kBlock * slot(p, q)) += block;
  } else {
    Block(values_.data() + kBlock * slot(q, p)) += block.transpose();
  }
}

void ClosureFactor::factorize(const std::vector<const ClosureTerm*>& closures, const Matrix6d& information) {
  analyze(closures, order_.size() != variables_);
  if (work_ > kReorderGrowth * ordered_work_) analyze(closures, true);
  const std::size_t n = variables_;
  values_.assign(kBlock * rows_.size(), 0.0);
  inverse_.resize(kBlock * n);
  for (std::uint32_t v = 0; v < n; ++v) {
    Block(values_.data() + kBlock * start_[position_[v]]) = diagonal_[v];
  }
  for (const Pair& pair : pairs_) add_block(pair.a, pair.b, pair.block);
  for (const ClosureTerm* c : closures) {
    const std::uint32_t a = variable_[c->from], b = variable_[c->to];
    const Matrix6d omega = c->scale * information;
    const Matrix6d AtO = c->adjoint.transpose() * omega;
    if (a != kHeld) Block(values_.data() + kBlock * start_[position_[a]]) += AtO * c->adjoint;
    if (b != kHeld) Block(values_.data() + kBlock * start_[position_[b]]) += omega;
    if (a != kHeld && b != kHeld) add_block(a, b, -AtO);
  }

  const ClosureKernels& kernels = closure_kernels();
  // Left-looking: every column receives the updates of the columns to its left that reach it. Lists by row
  // hold the columns that reach this row next.
  head_.assign(n, UINT32_MAX);
  next_.resize(n);
  cursor_.resize(n);
  place_.resize(n);
  const auto wait = [&](std::uint32_t j) {
    if (cursor_[j] == start_[j + 1]) return;
    const std::uint32_t row = rows_[cursor_[j]];
    next_[j] = head_[row];
    head_[row] = j;
  };
  for (std::uint32_t k = 0; k < n; ++k) {
    for (std::size_t p = start_[k]; p < start_[k + 1]; ++p) place_[rows_[p]] = static_cast<std::uint32_t>(p);
    std::array<double, 6> before;
    double* diagonal = values_.data() + kBlock * start_[k];
    for (std::size_t i = 0; i < 6; ++i) before[i] = diagonal[7 * i];
    for (std::uint32_t j = head_[k]; j != UINT32_MAX;) {
      const std::uint32_t following = next_[j];
      kernels.update(rows_.data(), place_.data(), cursor_[j], start_[j + 1], values_.data());
      ++cursor_[j];
      wait(j);
      j = following;
    }
    double* inverse = inverse_.data() + kBlock * k;
    bool definite = factorize_block(diagonal, inverse);
    for (std::size_t i = 0; i < 6 && definite; ++i) {
      definite = diagonal[7 * i] * diagonal[7 * i] >= kSingularPivot * before[i];
    }
    if (!definite) {
      throw InputError("node " + key_name(keys_[order_[k]]) +
                       ": the factors do not determine its pose, so it has no covariance");
    }
    for (std::size_t p = start_[k] + 1; p < start_[k + 1]; ++p) {
      double* block = values_.data() + kBlock * p;
      double product[kBlock] = {};
      subtract_abt(block, inverse, product);
      for (std::size_t i = 0; i < kBlock; ++i) block[i] = -product[i];
    }
    cursor_[k] = start_[k] + 1;
    wait(k);
  }
}

template <int Width>
void ClosureFactor::closure_columns(const ClosureTerm* const* closures, std::vector<double>& x) const {
  constexpr std::size_t kRows = 6 * Width;
  const std::size_t n = variables_;
  x.assign(kRows * n, 0.0);
  // Forward substitution only changes the columns on the paths from the closures' nodes to the root.
  std::vector<std::uint32_t> path;
  for (int c = 0; c < Width / 6; ++c) {
    if (closures[c] == nullptr) continue;
    const ClosureTerm& closure = *closures[c];
    const auto put = [&](std::size_t node, bool from) {
      if (held(node)) return;
      const std::uint32_t p = position_[variable_[node]];
      double* rows = x.data() + kRows * p + 6 * c;
      for (int i = 0; i < 6; ++i) {
        for (int j = 0; j < 6; ++j) {
          rows[Width * i + j] += from ? -closure.adjoint(j, i) : (i == j ? 1.0 : 0.0);
        }
      }
      path.push_back(p);
    };
    put(closure.from, true);
    put(closure.to, false);
  }
  std::vector<bool> on_path(n, false);
  for (std::size_t i = 0, given = path.size(); i < given; ++i) {
    std::uint32_t p = path[i];
    if (on_path[p]) continue;
    on_path[p] = true;
    while (parent_[p] != p && !on_path[parent_[p]]) {
      p = parent_[p];
      on_path[p] = true;
      path.push_back(p);
    }
  }
  std::sort(path.begin(), path.end());
  path.erase(std::unique(path.begin(), path.end()), path.end());
  closure_kernels().forward(columns(), path.data(), path.size(), Width, x.data());
  closure_kernels().backward(columns(), Width, x.data());
}

template <int Width>
void ClosureFactor::solve_root(std::vector<double>& x) const {
  closure_kernels().backward(columns(), Width, x.data());
}

template <int Width>
void ClosureFactor::solve(std::vector<double>& x) const {
  closure_kernels().forward(columns(), nullptr, 0, Width, x.data());
  closure_kernels().backward(columns(), Width, x.data());
}

template <int Width>
void ClosureFactor::apply(const ClosureTerm& closure, const std::vector<double>& x, double* out) const {
  if (const double* to = rows_of(x, closure.to, Width)) {
    std::copy_n(to, 6 * Width, out);
  } else {
    std::fill_n(out, 6 * Width, 0.0);
  }
  if (const double* from = rows_of(x, closure.from, Width)) {
    closure_kernels().subtract(closure.adjoint.data(), from, Width, out);
  }
}

ClosureFactor::Traces ClosureFactor::traces() const {
  // Takahashi's recursion on the blocks of L, from the last column to the first: with Y = L_Rj L_jj⁻¹,
  // Z_Rj = −Z_RR Y and Z_jj = L_jj⁻ᵀL_jj⁻¹ − Yᵀ Z_Rj.
  const std::size_t n = variables_;
  std::vector<double> z(values_.size()), y;
  Traces out;
  for (std::size_t j = n; j-- > 0;) {
    const ConstBlock inverse(inverse_.data() + kBlock * j);
    const std::size_t first = start_[j] + 1, last = start_[j + 1];
    y.resize(kBlock * (last - first));
    for (std::size_t p = first; p < last; ++p) {
      Block(y.data() + kBlock * (p - first)).noalias() =
          ConstBlock(values_.data() + kBlock * p).lazyProduct(inverse);
      Block(z.data() + kBlock * p).setZero();
    }
    for (std::size_t p = first; p < last; ++p) {
      const std::uint32_t k = rows_[p];
      std::size_t at = start_[k];
      for (std::size_t q = p; q < last; ++q) {
        while (rows_[at] != rows_[q]) ++at;
        const ConstBlock z_qp(z.data() + kBlock * at);
        Block(z.data() + kBlock * q).noalias() -=
            z_qp.lazyProduct(ConstBlock(y.data() + kBlock * (p - first)));
        if (q != p) {
          Block(z.data() + kBlock * p).noalias() -=
              z_qp.transpose().lazyProduct(ConstBlock(y.data() + kBlock * (q - first)));
        }
      }
    }
    Block z_jj(z.data() + kBlock * start_[j]);
    z_jj.noalias() = inverse.transpose().lazyProduct(inverse);
    for (std::size_t p = first; p < last; ++p) {
      z_jj.noalias() -= ConstBlock(y.data() + kBlock * (p - first))
                            .transpose()
                            .lazyProduct(ConstBlock(z.data() + kBlock * p));
    }
    out.translation += z_jj(0, 0) + z_jj(1, 1) + z_jj(2, 2);
    out.full += z_jj.trace();
  }
  return out;
}

double ClosureFactor::log_determinant() const {
  double sum = 0.0;
  for (std::size_t k = 0; k < variables_; ++k) {
    for (std::size_t i = 0; i < 6; ++i) sum += 2.0 * std::log(values_[kBlock * start_[k] + 7 * i]);
  }
  return sum;
}

template void ClosureFactor::closure_columns<6>(const ClosureTerm* const*, std::vector<double>&) const;
template void ClosureFactor::closure_columns<12>(const ClosureTerm* const*, std::vector<double>&) const;
template void ClosureFactor::closure_columns<24>(const ClosureTerm* const*, std::vector<double>&) const;
template void ClosureFactor::solve<6>(std::vector<double>&) const;
template void ClosureFactor::solve<12>(std::vector<double>&) const;
template void ClosureFactor::solve<16>(std::vector<double>&) const;
template void ClosureFactor::solve<24>(std::vector<double>&) const;
template void ClosureFactor::solve_root<16>(std::vector<double>&) const;
template void ClosureFactor::apply<6>(const ClosureTerm&, const std::vector<double>&, double*) const;
template void ClosureFactor::apply<12>(const ClosureTerm&, const std::vector<double>&, double*) const;
template void ClosureFactor::apply<16>(const ClosureTerm&, const std::vector<double>&, double*) const;
template void ClosureFactor::apply<24>(const ClosureTerm&, const std::vector<double>&, double*) const;

}  // namespace loopwise::detail
