// SPDX-License-Identifier: BSD-3-Clause
#include "closure_factor.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>

#include "linalg/selected_inverse.hpp"

namespace loopwise::detail {
namespace {

const PoseGraph& require_3d(const PoseGraph& graph) {
  if (!graph.planar()) return graph;
  throw InputError(
      "a 2D graph, but candidates are found and registered in 3D: only optimize, evaluate, info and convert "
      "support it");
}

const DenseKernels& portable_kernels() {
  return dense_kernels(Rounding::kPortable);
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

ClosureFactor::ClosureFactor(const PoseGraph& graph)
    : graph_(require_3d(graph)), cholesky_(6, Factorization::kMultifrontal, Rounding::kPortable) {
  for (const std::uint32_t node : graph_.nodes) keys_.push_back(graph.nodes()[node].key);
  for (const double value : graph_.blocks.values()) {
    if (!std::isfinite(value)) throw InputError("the Hessian at the poses is not finite");
  }
}

void ClosureFactor::load(const std::vector<const ClosureTerm*>& closures, const Matrix6d& information) {
  BlockMatrix& matrix = cholesky_.matrix();
  matrix.assign(graph_.blocks);
  std::size_t pair = graph_.blocks.pairs().size();
  for (const ClosureTerm* c : closures) {
    const std::uint32_t a = graph_.variable[c->from], b = graph_.variable[c->to];
    const Matrix6d omega = c->scale * information;
    const Matrix6d AtO = c->adjoint.transpose() * omega;
    if (a != GraphHessian::kHeld) matrix.add(matrix.diagonal_slot(a), Matrix6d(AtO * c->adjoint));
    if (b != GraphHessian::kHeld) matrix.add(matrix.diagonal_slot(b), omega);
    if (a == GraphHessian::kHeld || b == GraphHessian::kHeld) continue;
    matrix.add(matrix.pair_slot(pair++), Matrix6d(-AtO));
  }
}

void ClosureFactor::factorize(const std::vector<const ClosureTerm*>& closures, const Matrix6d& information) {
  std::vector<BlockPair> pairs = graph_.blocks.pairs();
  for (const ClosureTerm* c : closures) {
    if (!held(c->from) && !held(c->to)) {
      pairs.emplace_back(graph_.variable[c->from], graph_.variable[c->to]);
    }
  }
  if (ordered_) {
    cholesky_.analyze_again(pairs);
  } else {
    cholesky_.analyze(free_nodes(), pairs);
    ordered_ = true;
  }
  load(closures, information);
  const bool definite = cholesky_.factorize();
  const auto [pivot, variable] = cholesky_.smallest_pivot();
  if (!definite || pivot < kSingularPivot) {
    throw InputError("node " + key_name(keys_[variable]) +
                     ": the factors do not determine its pose, so it has no covariance");
  }
  invert_diagonal(cholesky_.fronts());
}

template <int Width>
void ClosureFactor::closure_columns(const ClosureTerm* const* closures, std::vector<double>& x) const {
  constexpr std::size_t kRows = 6 * Width;
  x.assign(kRows * free_nodes(), 0.0);
  std::vector<std::uint32_t> columns;
  for (int c = 0; c < Width / 6; ++c) {
    if (closures[c] == nullptr) continue;
    const ClosureTerm& closure = *closures[c];
    const auto put = [&](std::size_t node, bool from) {
      if (held(node)) return;
      columns.push_back(position(node));
      double* rows = x.data() + kRows * columns.back() + 6 * c;
      for (int i = 0; i < 6; ++i) {
        for (int j = 0; j < 6; ++j) {
          rows[Width * i + j] += from ? -closure.adjoint(j, i) : (i == j ? 1.0 : 0.0);
        }
      }
    };
    put(closure.from, true);
    put(closure.to, false);
  }
  // Forward substitution only changes the rows on the paths from the closures' nodes to the root.
  const PanelView l = cholesky_.fronts().view();
  const std::vector<PathStep> path = sparse_path(cholesky_.fronts(), std::move(columns));
  portable_kernels().forward(l, path.data(), path.size(), Width, x.data());
  portable_kernels().backward(l, Width, x.data());
}

template <int Width>
void ClosureFactor::solve_root(std::vector<double>& x) const {
  portable_kernels().backward(cholesky_.fronts().view(), Width, x.data());
}

template <int Width>
void ClosureFactor::solve(std::vector<double>& x) const {
  portable_kernels().forward(cholesky_.fronts().view(), nullptr, 0, Width, x.data());
  portable_kernels().backward(cholesky_.fronts().view(), Width, x.data());
}

template <int Width>
void ClosureFactor::apply(const ClosureTerm& closure, const std::vector<double>& x, double* out) const {
  if (const double* to = rows_of(x, closure.to, Width)) {
    std::copy_n(to, 6 * Width, out);
  } else {
    std::fill_n(out, 6 * Width, 0.0);
  }
  if (const double* from = rows_of(x, closure.from, Width)) {
    portable_kernels().subtract_wide(closure.adjoint.data(), from, Width, out);
  }
}

ClosureFactor::Traces ClosureFactor::traces() const {
  const Eigen::MatrixXd blocks = selected_inverse(cholesky_.fronts(), Rounding::kPortable);
  Traces out;
  for (Eigen::Index at = 0; at < blocks.cols(); at += 6) {
    const auto block = blocks.middleCols<6>(at);
    const double translation = block(0, 0) + block(1, 1) + block(2, 2);
    out.translation += translation;
    out.full += translation + block(3, 3) + block(4, 4) + block(5, 5);
  }
  return out;
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
