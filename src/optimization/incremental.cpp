// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/incremental.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>

#include "incremental_problem.hpp"
#include "linalg/blas_threads.hpp"

namespace loopwise {

using detail::NumberSet;
using detail::Pose;

namespace {

/// Descent is slow if a step promises more than this share of the step before.
constexpr double kFastDescent = 0.1;
/// Slow descent multiplies the threshold of relinearisation by this factor.
constexpr double kTightening = 0.1;

}  // namespace

struct IncrementalOptimizer::Impl {
  detail::IncrementalProblem problem;
  OptimizerOptions optimization;
  IncrementalOptions options;
  ThreadPool pool;
  NumberSet moved;                     // nodes whose new poses are not yet in `problem.graph`
  std::vector<double> x;               // the step, six values per position; zero between solutions
  std::vector<std::uint32_t> visited;  // positions for which the step was computed

  Impl(const OptimizerOptions& of_whole, const IncrementalOptions& of_updates)
      : optimization(of_whole), options(of_updates), pool(of_whole.threads) {}

  struct Step {
    double promise = 0.0;  ///< Predicted decrease of the cost
    double largest = 0.0;  ///< Largest element, relative to the deviation by the node's own factors
  };
  Step solve(double tolerance);
  double move(std::vector<Pose>& before);
  void move_back(const std::vector<Pose>& before, double cost);
  void close();
  void store_poses();
  void from_scratch(Initialization initialization, const StopToken& stop, IncrementalResult& result);
  void descend(const StopToken& stop, IncrementalResult& result);
  void update(const StopToken& stop, IncrementalResult& result);

  [[nodiscard]] bool small(const Step& step) const {
    return step.promise < 0.5 * options.tolerance * options.tolerance || step.largest < options.tolerance;
  }
};

/// Computes the step of the open nodes in `x`, as far as its elements exceed the tolerance.
IncrementalOptimizer::Impl::Step IncrementalOptimizer::Impl::solve(double tolerance) {
  detail::IncrementalCholesky& cholesky = problem.cholesky();
  const std::vector<std::uint32_t>& open = problem.open().numbers();
  x.resize(6 * problem.poses.size(), 0.0);
  const auto at = [&](std::uint32_t position) {
    return Eigen::Map<Vector6d>(x.data() + 6 * std::size_t{position});
  };
  std::vector<std::uint32_t> nonzero;
  for (const std::uint32_t node : open) {
    nonzero.push_back(cholesky.position(node));
    at(nonzero.back()) = problem.held(node) ? Vector6d(Vector6d::Zero()) : Vector6d(-problem.gradient(node));
  }
  cholesky.solve(nonzero, tolerance, x, visited);
  Step step;
  for (std::size_t i = 0; i < open.size(); ++i) {
    step.promise -= 0.5 * problem.gradient(open[i]).dot(at(nonzero[i]));
  }
  for (const std::uint32_t p : visited) {
    for (int k = 0; k < 6; ++k)
      step.largest = std::max(step.largest, std::abs(at(p)[k]) * cholesky.sqrt_diagonal(p, k));
  }
  return step;
}

/// Moves the visited nodes by `x` and sets `x` to zero. \returns the change of the cost
double IncrementalOptimizer::Impl::move(std::vector<Pose>& before) {
  before.clear();
  problem.clear_changed();
  std::vector<std::uint32_t> nodes;
  nodes.reserve(visited.size());
  for (const std::uint32_t p : visited) {
    Eigen::Map<Vector6d> step(x.data() + 6 * std::size_t{p});
    const std::uint32_t node = problem.cholesky().variable_at(p);
    nodes.push_back(node);
    before.push_back(problem.poses[node]);
    if (!problem.held(node)) problem.poses[node] = detail::moved_by(problem.poses[node], step);
    step.setZero();
  }
  problem.change_at(nodes);
  return problem.evaluate_changed(pool);
}

void IncrementalOptimizer::Impl::move_back(const std::vector<Pose>& before, double cost) {
  for (std::size_t i = 0; i < visited.size(); ++i) {
    problem.poses[problem.cholesky().variable_at(visited[i])] = before[i];
  }
  problem.evaluate_back(cost, pool);
}

/// After the last step: nodes at the border of the visited ones stay open.
void IncrementalOptimizer::Impl::close() {
  NumberSet been;
  been.grow(problem.poses.size());
  for (const std::uint32_t p : visited) been.insert(problem.cholesky().variable_at(p));
  problem.open().clear();
  problem.reopen_changed(&been);
}

void IncrementalOptimizer::Impl::store_poses() {
  const std::vector<Node>& nodes = problem.graph.nodes();
  if (2 * moved.numbers().size() > nodes.size()) {  // faster than to look for each key
    std::vector<Eigen::Isometry3d> poses;
    poses.reserve(nodes.size());
    for (std::uint32_t i = 0; i < nodes.size(); ++i) {
      poses.push_back(moved.contains(i) ? detail::isometry(problem.poses[i]) : nodes[i].pose);
    }
    problem.graph.set_poses(poses);
  } else {
    for (const std::uint32_t node : moved.numbers()) {
      problem.graph.set_pose(nodes[node].key, detail::isometry(problem.poses[node]));
    }
  }
  moved.clear();
}

void IncrementalOptimizer::Impl::from_scratch(Initialization initialization, const StopToken& stop,
                                              IncrementalResult& result) {
  store_poses();
  OptimizerOptions from = optimization;
  from.initialization = initialization;
  const OptimizationResult solution = loopwise::optimize(problem.graph, from, stop);
  problem.graph.set_poses(solution.poses);
  for (std::size_t i = 0; i < problem.poses.size(); ++i) {
    problem.poses[i].R = solution.poses[i].linear();
    problem.poses[i].t = solution.poses[i].translation();
  }
  problem.reorder();
  problem.open().clear();
  for (std::uint32_t i = 0; i < problem.poses.size() && !solution.converged; ++i) problem.open().insert(i);
  // If this fails, the next update fails too and is also made from scratch.
  static_cast<void>(problem.factorize());
  result.from_scratch = result.reordered = true;
  result.iterations += solution.iterations;
  result.converged = solution.converged;
}

/// Quasi-Newton: the gradient is exact, the Hessian belongs to nearby poses. A step that does not lower the
/// cost is undone and repeated for all nodes, since a step that ends at the tolerance need not lead downhill.
/// If that fails, it is repeated with the Hessian at the present poses, and then the damped optimiser takes
/// over.
void IncrementalOptimizer::Impl::descend(const StopToken& stop, IncrementalResult& result) {
  std::vector<Pose> before;
  double share = options.relinearization, tolerance = options.tolerance;
  double promise = std::numeric_limits<double>::infinity();
  while (result.iterations < options.max_iterations && !problem.open().numbers().empty()) {
    if (stop.stop_requested()) return;
    if (!problem.factorize()) return from_scratch(Initialization::kFile, stop, result);
    const Step step = solve(tolerance);
    const double cost = problem.cost(), difference = move(before);
    if (!std::isfinite(difference) || (difference > 1e-12 * cost && !small(step))) {
      move_back(before, cost);
      if (tolerance > 0.0) {
        tolerance = 0.0;
        continue;
      }
      if (share == 0.0 || problem.relinearize(0.0) == 0)
        return from_scratch(Initialization::kFile, stop, result);
      share = 0.0;
      continue;
    }
    tolerance = options.tolerance;
    ++result.iterations;
    result.moved += visited.size();
    for (const std::uint32_t p : visited) moved.insert(problem.cholesky().variable_at(p));
    // If the steps shrink slowly, the Hessian belongs to poses that are too far away.
    share = step.promise > kFastDescent * promise ? kTightening * std::min(share, options.relinearization)
                                                  : options.relinearization;
    promise = step.promise;
    result.relinearized += problem.relinearize(share);
    if (small(step)) {
      result.converged = true;
      return close();
    }
    problem.open().clear();
    problem.reopen_changed();
    if (std::abs(step.promise + difference) < options.remainder * step.promise) return;
  }
}

void IncrementalOptimizer::Impl::update(const StopToken& stop, IncrementalResult& result) {
  const std::size_t nodes = problem.graph.nodes().size();
  moved.grow(nodes);
  if (nodes > 2 * problem.absorbed_nodes()) {
    const bool first = problem.absorbed_nodes() == 0;
    from_scratch(first ? optimization.initialization : Initialization::kFile, stop, result);
  } else {
    result.reordered = problem.absorb();
    descend(stop, result);
    store_poses();
  }
  result.converged = result.converged || problem.open().numbers().empty();
  result.cost = problem.cost();
}

IncrementalOptimizer::IncrementalOptimizer(PoseGraph graph, const OptimizerOptions& optimization,
                                           const IncrementalOptions& options) {
  validate(optimization);
  validate(options);
  impl_ = std::make_unique<Impl>(optimization, options);
  impl_->problem.graph = std::move(graph);
  if (!impl_->problem.graph.empty()) static_cast<void>(update());
}
IncrementalOptimizer::~IncrementalOptimizer() = default;
IncrementalOptimizer::IncrementalOptimizer(IncrementalOptimizer&&) noexcept = default;
IncrementalOptimizer& IncrementalOptimizer::operator=(IncrementalOptimizer&&) noexcept = default;

std::size_t IncrementalOptimizer::add_node(const Node& node) {
  return impl_->problem.graph.add_node(node);
}

std::size_t IncrementalOptimizer::add_edge(const Edge& edge) {
  return impl_->problem.graph.add_edge(edge);
}

std::size_t IncrementalOptimizer::add_prior(const PriorFactor& prior) {
  return impl_->problem.graph.add_prior(prior);
}

std::size_t IncrementalOptimizer::add_range(const RangeFactor& range) {
  return impl_->problem.graph.add_range(range);
}

std::size_t IncrementalOptimizer::add_gravity(const GravityFactor& gravity) {
  return impl_->problem.graph.add_gravity(gravity);
}

void IncrementalOptimizer::set_weight(std::size_t edge, double weight) {
  if (edge >= impl_->problem.graph.edges().size())
    throw InputError("edge " + std::to_string(edge) + " is not in the graph");
  impl_->problem.graph.set_weight(edge, weight);
  impl_->problem.weight_changed(edge);
}

IncrementalResult IncrementalOptimizer::update(const StopToken& stop) {
  const Stopwatch watch;
  const detail::SingleThreadedBlas guard;
  IncrementalResult result;
  impl_->update(stop, result);
  result.seconds = watch.seconds();
  return result;
}

const PoseGraph& IncrementalOptimizer::graph() const {
  return impl_->problem.graph;
}

}  // namespace loopwise
