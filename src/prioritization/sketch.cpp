// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <tuple>
#include <unordered_map>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>

#include "cell.hpp"
#include "closure_factor.hpp"
#include "closure_set.hpp"
#include "probes.hpp"

namespace loopwise {
namespace {

constexpr int kSketchWidth = 16;  // probes per solve
constexpr std::size_t kCandidatesPerTask = 4096;

using Probes = Eigen::Matrix<double, 6, kSketchWidth, Eigen::RowMajor>;

/// Calls visit(i, blocks) for every candidate that does not connect components, with estimates of S and M
/// from random probes. They are for its closure at full information, added to the bare graph. Several threads
/// call at a time.
template <class Visit>
void for_each_sketch(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                     const ClosureModelOptions& options, const ClosureModel& model, std::size_t probes,
                     std::uint64_t seed, const Visit& visit) {
  validate(options);
  if (probes == 0) throw OptionError("probes = 0, must be >= 1");
  const detail::Whitening whitening(model.covariance);
  const detail::GraphComponents parts(graph);
  detail::ClosureFactor factor(graph);
  factor.factorize({}, whitening.information);

  // Probes are in groups of kSketchWidth; the signs of a group depend only on (seed, group).
  const std::size_t groups = (probes + kSketchWidth - 1) / kSketchWidth;
  const double scale = 1.0 / std::sqrt(static_cast<double>(groups * kSketchWidth));
  std::vector<std::vector<double>> U(groups), V(groups);
  ThreadPool pool(options.threads);
  pool.for_each(2 * groups, [&](std::size_t task) {
    const std::size_t group = task / 2;
    const bool of_trace = task % 2 != 0;
    std::vector<double>& x = of_trace ? V[group] : U[group];
    detail::fill_probes(x, factor.free_nodes(), kSketchWidth,
                        of_trace && options.trace == TraceKind::kTranslation ? 3 : 6, scale,
                        Rng(combine_seeds(combine_seeds(seed, group), of_trace ? 1 : 0)));
    of_trace ? factor.solve<kSketchWidth>(x) : factor.solve_root<kSketchWidth>(x);
  });

  pool.for_each((candidates.size() + kCandidatesPerTask - 1) / kCandidatesPerTask, [&](std::size_t chunk) {
    const std::size_t end = std::min(candidates.size(), (chunk + 1) * kCandidatesPerTask);
    for (std::size_t i = chunk * kCandidatesPerTask; i < end; ++i) {
      const std::size_t from = graph.index_of(candidates[i].from), to = graph.index_of(candidates[i].to);
      if (parts.connecting(from, to)) continue;
      detail::ClosureTerm term;
      term.from = static_cast<std::uint32_t>(from);
      term.to = static_cast<std::uint32_t>(to);
      term.adjoint = se3::adjoint(graph.nodes()[to].pose.inverse() * graph.nodes()[from].pose);
      detail::GainBlocks blocks;
      for (std::size_t g = 0; g < groups; ++g) {
        Probes u, v;
        factor.apply<kSketchWidth>(term, U[g], u.data());
        factor.apply<kSketchWidth>(term, V[g], v.data());
        blocks.S.noalias() += u.lazyProduct(u.transpose());
        blocks.M.noalias() += v.lazyProduct(v.transpose());
      }
      blocks.S = (whitening.root * blocks.S * whitening.root.transpose()).eval();
      blocks.M = (whitening.root * blocks.M * whitening.root.transpose()).eval();
      visit(i, blocks);
    }
  });
}

void check_count(const char* what, std::size_t count, std::size_t candidates) {
  if (count == 0 || count == candidates) return;
  throw InputError(std::string(what) + " has " + std::to_string(count) + " values, expected " +
                   std::to_string(candidates) + " or none");
}

}  // namespace

std::vector<double> sketched_gains(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                                   const ClosureModelOptions& options, const ClosureModel& model,
                                   std::size_t probes, std::uint64_t seed) {
  check_count("information_factors", model.information_factors.size(), candidates.size());
  std::vector<double> gains(candidates.size(), 0.0);
  for_each_sketch(
      graph, candidates, options, model, probes, seed, [&](std::size_t i, detail::GainBlocks& blocks) {
        const double factor = model.information_factors.empty() ? 1.0 : model.information_factors[i];
        blocks.S *= factor;
        blocks.M *= factor;
        gains[i] = blocks.gain();
      });
  return gains;
}

std::vector<std::size_t> spread_shortlist(const PoseGraph& graph,
                                          const std::vector<LoopCandidate>& candidates,
                                          const std::vector<double>& gains, std::size_t count,
                                          double cell_m) {
  if (gains.size() != candidates.size()) throw InputError("one gain for each candidate is needed");
  if (!(cell_m > 0.0)) throw OptionError("cell_m must be > 0");
  std::vector<std::size_t> order(candidates.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  if (count >= candidates.size()) return order;

  std::unordered_map<Key, std::uint64_t> cells;
  const auto cell_of = [&](Key key) {
    const auto [found, fresh] = cells.emplace(key, 0);
    if (fresh) found->second = detail::cell_of(graph.node(key).pose.translation(), cell_m);
    return found->second;
  };
  const auto better = [&](std::size_t a, std::size_t b) {
    return gains[a] != gains[b] ? gains[a] > gains[b] : a < b;
  };
  std::sort(order.begin(), order.end(), better);
  std::unordered_map<std::uint64_t, std::size_t> met;  // pair of cells -> candidates seen in it
  std::vector<std::size_t> round(candidates.size());
  for (const std::size_t i : order) {
    const std::uint64_t a = cell_of(candidates[i].from), b = cell_of(candidates[i].to);
    round[i] = met[combine_seeds(std::min(a, b), std::max(a, b))]++;
  }
  const auto earlier = [&](std::size_t a, std::size_t b) {
    return round[a] != round[b] ? round[a] < round[b] : better(a, b);
  };
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(count), order.end(), earlier);
  order.resize(count);
  std::sort(order.begin(), order.end());
  return order;
}

}  // namespace loopwise
