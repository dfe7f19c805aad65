// SPDX-License-Identifier: BSD-3-Clause
#include "relative_sketch.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/core/thread_pool.hpp>

#include "closure_factor.hpp"
#include "probes.hpp"

namespace loopwise::detail {
namespace {

constexpr int kProbesPerSolve = 16;  // probes per solve
using SketchRows = Eigen::Matrix<float, 6, Eigen::Dynamic, Eigen::RowMajor>;

}  // namespace

RelativeSketch::RelativeSketch(const PoseGraph& graph, const ClosureModelOptions& options, std::size_t probes,
                               std::uint64_t seed) {
  const std::size_t groups = (probes + kProbesPerSolve - 1) / kProbesPerSolve;
  probes_ = groups * kProbesPerSolve;
  whitening_ << Eigen::Vector3d::Constant(1.0 / options.sigma_m),
      Eigen::Vector3d::Constant(1.0 / options.sigma_rad);
  ClosureFactor factor(graph);
  factor.factorize({}, Matrix6d::Identity());
  const std::size_t nodes = graph.nodes().size();
  U_.assign(nodes * 6 * probes_, 0.0F);
  V_.assign(nodes * 6 * probes_, 0.0F);
  const double scale = 1.0 / std::sqrt(static_cast<double>(probes_));
  const std::size_t trace_rows = options.trace == TraceKind::kTranslation ? 3 : 6;
  ThreadPool pool(options.threads);
  pool.for_each(2 * groups, [&](std::size_t task) {
    const std::size_t group = task / 2;
    const bool of_trace = task % 2 != 0;
    std::vector<double> x;
    fill_probes(x, factor.free_nodes(), kProbesPerSolve, of_trace ? trace_rows : 6, scale,
                Rng(combine_seeds(combine_seeds(seed, group), of_trace ? 1 : 0)));
    of_trace ? factor.solve<kProbesPerSolve>(x) : factor.solve_root<kProbesPerSolve>(x);
    std::vector<float>& out = of_trace ? V_ : U_;
    for (std::size_t node = 0; node < nodes; ++node) {
      const double* rows = factor.rows_of(x, node, kProbesPerSolve);
      if (rows == nullptr) continue;
      for (std::size_t row = 0; row < 6; ++row) {
        float* to = out.data() + (node * 6 + row) * probes_ + group * kProbesPerSolve;
        for (std::size_t k = 0; k < kProbesPerSolve; ++k)
          to[k] = static_cast<float>(rows[row * kProbesPerSolve + k]);
      }
    }
  });
  nodes_ = nodes;
}

RepeatedGain RelativeSketch::gain(std::size_t from, std::size_t to,
                                  const Eigen::Isometry3d& T_to_from) const {
  RepeatedGain out;
  if (from >= nodes_ || to >= nodes_) return out;
  const Eigen::Matrix<float, 6, 6> adjoint = se3::adjoint(T_to_from).cast<float>();
  const auto columns = static_cast<Eigen::Index>(probes_);
  const auto effect = [&](const std::vector<float>& x) {
    const Eigen::Map<const SketchRows> at_from(x.data() + from * 6 * probes_, 6, columns);
    const Eigen::Map<const SketchRows> at_to(x.data() + to * 6 * probes_, 6, columns);
    SketchRows rows = at_to;
    rows.noalias() -= adjoint * at_from;
    return Matrix6d((rows * rows.transpose()).cast<double>());
  };
  const Matrix6d S = effect(U_);
  const Matrix6d white = whitening_.asDiagonal() * S * whitening_.asDiagonal();
  const Matrix6d M = whitening_.asDiagonal() * effect(V_) * whitening_.asDiagonal();
  const auto of = [&](double closures) {
    return (Matrix6d::Identity() / closures + white).llt().solve(M).trace();
  };
  // A·k/(k + κ), fitted to the gains of one closure and of four.
  const double one = of(1.0), four = of(4.0);
  if (!(one > 0.0) || !std::isfinite(four)) return out;
  const double ratio = std::clamp(four / one, 1.0 + 1e-6, 4.0 - 1e-3);  // 4(1 + κ)/(4 + κ)
  out.half = std::max(4.0 * (ratio - 1.0) / (4.0 - ratio), 1e-6);
  out.most = one * (1.0 + out.half);
  return out;
}

}  // namespace loopwise::detail
