// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/closure_effects.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/optimization/marginals.hpp>

#include "closure_set.hpp"

namespace loopwise {
namespace {

using Eigen::Index;

/// Variances below this (m²) belong to nodes with a fixed pose.
constexpr double kHeldVariance = 1e-14;
/// Candidates per task of the pool.
constexpr std::size_t kPairsPerTask = 64;

Eigen::Matrix3d world_covariance(const Node& node, const Matrix6d& covariance) {
  if (!covariance.allFinite()) return Eigen::Matrix3d::Zero();
  const Eigen::Matrix3d R = node.pose.linear();
  return R * covariance.topLeftCorner<3, 3>() * R.transpose();
}

/// Chains of nodes joined by odometry, in the order of their keys.
struct Chains {
  std::vector<std::uint32_t> chain;     // by node
  std::vector<std::uint32_t> position;  // by node, within its chain
  std::vector<std::uint32_t> order;     // all nodes, chain by chain

  explicit Chains(const PoseGraph& graph) {
    const std::size_t n = graph.nodes().size();
    DisjointSets chained(n);
    for (std::size_t e = 0; e < graph.edges().size(); ++e) {
      if (graph.edges()[e].kind == EdgeKind::kOdometry) chained.join(graph.ends(e).from, graph.ends(e).to);
    }
    chain.resize(n);
    for (std::uint32_t i = 0; i < n; ++i) chain[i] = chained.root(i);
    order.resize(n);
    std::iota(order.begin(), order.end(), 0U);
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
      return chain[a] != chain[b] ? chain[a] < chain[b] : graph.nodes()[a].key < graph.nodes()[b].key;
    });
    position.resize(n);
    for (std::uint32_t k = 0, at = 0; k < n; ++k, ++at) {
      if (k > 0 && chain[order[k]] != chain[order[k - 1]]) at = 0;
      position[order[k]] = at;
    }
  }
};

/// Nodes in groups that follow each other along the chains. Each group has about the same share of the
/// variance and of the number of nodes.
std::vector<std::vector<std::uint32_t>> strata_of(const Chains& chains,
                                                  const std::vector<Eigen::Matrix3d>& world, double trace_m2,
                                                  std::size_t count) {
  const std::size_t n = world.size();
  std::vector<std::vector<std::uint32_t>> strata(std::min(count, n));
  double measured = 0.0;
  for (const std::uint32_t i : chains.order) {
    const double part = 0.5 / static_cast<double>(n) +
                        (trace_m2 > 0.0 ? 0.5 * world[i].trace() / trace_m2 : 0.5 / static_cast<double>(n));
    const auto stratum =
        static_cast<std::size_t>((measured + 0.5 * part) * static_cast<double>(strata.size()));
    strata[std::min(stratum, strata.size() - 1)].push_back(i);
    measured += part;
  }
  strata.erase(std::remove_if(strata.begin(), strata.end(), [](const auto& s) { return s.empty(); }),
               strata.end());
  return strata;
}

/// Sets the anchors, one for each stratum, and the features of their units.
void add_anchors(const std::vector<std::vector<std::uint32_t>>& strata, const Chains& chains,
                 const std::vector<Eigen::Matrix3d>& world, double closure_variance, ClosureEffects& out) {
  const auto n = static_cast<double>(world.size());
  const auto unit_count = static_cast<Index>(3 * strata.size());
  out.share = Eigen::VectorXd::Zero(unit_count);
  out.units = Eigen::MatrixXd::Zero(unit_count, ClosureEffects::kUnitFeatures);
  const double mean_variance = std::max(kHeldVariance, out.trace_m2 / (3.0 * n));
  for (std::size_t s = 0; s < strata.size(); ++s) {
    ClosureEffects::Anchor anchor;
    anchor.node = strata[s][strata[s].size() / 2];
    anchor.chain = chains.chain[anchor.node];
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(world[anchor.node]);
    anchor.axes = eigen.eigenvectors().rowwise().reverse();
    anchor.variance = eigen.eigenvalues().reverse().cwiseMax(0.0);
    for (Index a = 0; a < 3; ++a) {
      const Index u = static_cast<Index>(3 * s) + a;
      for (const std::uint32_t i : strata[s])
        out.share[u] += anchor.axes.col(a).dot(world[i] * anchor.axes.col(a));
      const double v = std::max(kHeldVariance, anchor.variance[a]);
      out.units.row(u) << std::log(v / closure_variance), std::log(v / mean_variance), a == 0 ? 1.0 : 0.0,
          a == 1 ? 1.0 : 0.0, std::log(n);
    }
    out.anchors.push_back(anchor);
  }
  if (out.trace_m2 > 0.0) out.share /= out.trace_m2;
}

/// Sets where the ends of a candidate lie along the chains, as seen from each anchor.
void add_places(const detail::ClosureTerm& term, Index column, const Chains& chains,
                const std::vector<Eigen::Matrix3d>& world, double closure_variance, ClosureEffects& out) {
  for (std::size_t a = 0; a < out.anchors.size(); ++a) {
    const std::size_t node = out.anchors[a].node;
    const auto row = static_cast<Index>(a);
    const double known = std::min(world[term.from].trace(), world[term.to].trace()) / 3.0;
    out.reference(row, column) = static_cast<float>(
        std::log((known + closure_variance) / (world[node].trace() / 3.0 + closure_variance)));
    int before = 0, after = 0;
    std::uint32_t nearest = UINT32_MAX, farthest = 0;
    for (const std::uint32_t end : {term.from, term.to}) {
      if (chains.chain[end] != chains.chain[node]) continue;
      const std::uint32_t at = chains.position[end], here = chains.position[node];
      ++(at <= here ? before : after);
      const std::uint32_t gap = at < here ? here - at : at - here;
      nearest = std::min(nearest, gap);
      farthest = std::max(farthest, gap);
    }
    if (before + after == 0) continue;
    out.side(row, column) = before > 0 && after > 0 ? ClosureEffects::kAround
                            : before > 0            ? ClosureEffects::kBefore
                                                    : ClosureEffects::kAfter;
    out.gap(row, column) = static_cast<float>(std::log1p(static_cast<double>(nearest)));
    if (before + after == 2)
      out.far(row, column) = static_cast<float>(std::log1p(static_cast<double>(farthest)));
  }
}

/// Sets the gain of candidate `c` and the logarithms by which it reduces the variances of the units.
/// \param x room for the columns of the factor
void add_gain(const detail::ClosureSet& closures, const detail::ClosureFactor& factor, std::size_t c,
              const PoseGraph& graph, std::vector<double>& x, ClosureEffects& out) {
  const detail::ClosureTerm* term = &closures.terms[c];
  const auto column = static_cast<Index>(c);
  factor.closure_columns<6>(&term, x);
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor> raw;
  factor.apply<6>(*term, x, raw.data());
  const Matrix6d W = closures.whitener(c);
  Matrix6d S = W * raw * W.transpose();
  S = 0.5 * (S + S.transpose()).eval();
  const Eigen::LLT<Matrix6d> cholesky(Matrix6d::Identity() + S);
  const Matrix6d M = W * Matrix6d(detail::counted_gram<6>(x, TraceKind::kTranslation)) * W.transpose();
  out.gain[column] = cholesky.solve(M).trace() / out.trace_m2;
  for (std::size_t a = 0; a < out.anchors.size(); ++a) {
    const ClosureEffects::Anchor& anchor = out.anchors[a];
    const double* rows = factor.rows_of(x, anchor.node, 6);
    if (rows == nullptr) continue;
    const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> block(rows);
    const Eigen::Matrix<double, 3, 6> y = anchor.axes.transpose() * graph.nodes()[anchor.node].pose.linear() *
                                          block.topRows<3>() * W.transpose();
    for (Index k = 0; k < 3; ++k) {
      if (anchor.variance[k] <= kHeldVariance) continue;
      const Vector6d column_of = y.row(k).transpose();
      const double left = 1.0 - column_of.dot(cholesky.solve(column_of)) / anchor.variance[k];
      const double log_reduction =
          -std::log(std::clamp(left, std::exp(-ClosureEffects::kMaxLogReduction), 1.0));
      out.log_reduction(static_cast<Index>(3 * a) + k, column) = static_cast<float>(log_reduction);
    }
  }
}

}  // namespace

Eigen::MatrixXd ClosureEffects::edge_features(Index candidate) const {
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(unit_count(), kEdgeFeatures);
  const double log_gain = std::log(1e-6 + std::max(0.0, gain[candidate]));
  for (Index u = 0; u < unit_count(); ++u) {
    out(u, 0) = static_cast<double>(log_reduction(u, candidate));
    out(u, 1 + side(u / 3, candidate)) = 1.0;
    out(u, 5) = static_cast<double>(gap(u / 3, candidate));
    out(u, 6) = log_gain;
    out(u, 7) = static_cast<double>(far(u / 3, candidate));
    out(u, 8) = static_cast<double>(reference(u / 3, candidate));
  }
  return out;
}

ClosureEffects closure_effects(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                               const ClosureModelOptions& options, const ClosureModel& model,
                               std::size_t count) {
  if (count == 0) throw OptionError("count = 0, must be >= 1");
  detail::ClosureSet closures(graph, candidates, options, model);
  ClosureEffects out;
  const std::size_t n = graph.nodes().size();
  if (n == 0) return out;
  const std::vector<Matrix6d> covariances = marginals(graph).covariances;
  std::vector<Eigen::Matrix3d> world(n);
  for (std::size_t i = 0; i < n; ++i) {
    world[i] = world_covariance(graph.nodes()[i], covariances[i]);
    out.trace_m2 += world[i].trace();
  }
  const Chains chains(graph);
  const double closure_variance = model.covariance.topLeftCorner<3, 3>().trace() / 3.0;
  add_anchors(strata_of(chains, world, out.trace_m2, count), chains, world, closure_variance, out);

  const auto L = static_cast<Index>(candidates.size());
  const auto A = static_cast<Index>(out.anchors.size());
  out.log_reduction = Eigen::MatrixXf::Zero(3 * A, L);
  out.gap = Eigen::MatrixXf::Zero(A, L);
  out.far = Eigen::MatrixXf::Zero(A, L);
  out.reference = Eigen::MatrixXf::Zero(A, L);
  out.side.setConstant(A, L, ClosureEffects::kElsewhere);
  out.gain = Eigen::VectorXd::Zero(L);
  out.connecting.resize(candidates.size());
  const detail::ClosureFactor& factor = closures.factor();
  ThreadPool pool(options.threads);
  pool.for_each((candidates.size() + kPairsPerTask - 1) / kPairsPerTask, [&](std::size_t chunk) {
    std::vector<double> x;
    for (std::size_t c = chunk * kPairsPerTask; c < std::min(candidates.size(), (chunk + 1) * kPairsPerTask);
         ++c) {
      add_places(closures.terms[c], static_cast<Index>(c), chains, world, closure_variance, out);
      if (!closures.terms.inert(c) && out.trace_m2 > 0.0) add_gain(closures, factor, c, graph, x, out);
    }
  });
  for (std::size_t c = 0; c < candidates.size(); ++c) out.connecting[c] = closures.terms.connecting(c);
  return out;
}

Eigen::VectorXd unit_log_reductions(const ClosureEffects& effects, const PoseGraph& graph,
                                    const std::vector<Matrix6d>& covariances) {
  Eigen::VectorXd out = Eigen::VectorXd::Zero(effects.unit_count());
  for (std::size_t a = 0; a < effects.anchors.size(); ++a) {
    const ClosureEffects::Anchor& anchor = effects.anchors[a];
    const Eigen::Matrix3d world = world_covariance(graph.nodes()[anchor.node], covariances[anchor.node]);
    for (Index k = 0; k < 3; ++k) {
      const double v = anchor.variance[k];
      if (v <= kHeldVariance) continue;
      const double after = anchor.axes.col(k).dot(world * anchor.axes.col(k));
      out[static_cast<Index>(3 * a) + k] = std::log(v / std::max(kHeldVariance, after));
    }
  }
  return out;
}

}  // namespace loopwise
