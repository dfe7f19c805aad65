// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/optimizer.hpp>

#include <algorithm>
#include <utility>

#include <loopwise/core/clock.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "blas_threads.hpp"
#include "gnc_solver.hpp"
#include "initialization.hpp"
#include "minimize.hpp"
#include "pose_problem.hpp"

namespace loopwise {

EnumNames<Initialization> enum_names(Initialization) {
  return {{Initialization::kFile, "file"},
          {Initialization::kOdometry, "odometry"},
          {Initialization::kChordal, "chordal"}};
}

EnumNames<Factorization> enum_names(Factorization) {
  return {{Factorization::kAutomatic, "automatic"},
          {Factorization::kMultifrontal, "multifrontal"},
          {Factorization::kSimplicial, "simplicial"},
          {Factorization::kSupernodal, "supernodal"}};
}

EnumNames<Termination> enum_names(Termination) {
  return {{Termination::kConverged, "converged"},
          {Termination::kNothingToDo, "nothing_to_do"},
          {Termination::kMaxIterations, "max_iterations"},
          {Termination::kNoProgress, "no_progress"},
          {Termination::kStopped, "stopped"}};
}

struct PoseGraphOptimizer::Impl {
  OptimizerOptions options;
  ThreadPool pool;
  detail::NormalEquations equations;

  explicit Impl(const OptimizerOptions& o) : options(o), pool(o.threads), equations(o.factorization) {}
};

PoseGraphOptimizer::PoseGraphOptimizer(OptimizerOptions options) {
  validate(options);
  impl_ = std::make_unique<Impl>(options);
}
PoseGraphOptimizer::~PoseGraphOptimizer() = default;
PoseGraphOptimizer::PoseGraphOptimizer(PoseGraphOptimizer&&) noexcept = default;
PoseGraphOptimizer& PoseGraphOptimizer::operator=(PoseGraphOptimizer&&) noexcept = default;

std::size_t PoseGraphOptimizer::analyses() const {
  return impl_->equations.analyses();
}

namespace {

/// What the result says about the graph as a whole.
void describe_graph(const PoseGraph& graph, const detail::Freedom& freedom, OptimizationResult& result) {
  const auto component = connected_components(graph);
  for (const std::size_t c : component) result.components = std::max(result.components, c + 1);
  for (const std::size_t node : freedom.held) result.held.push_back(graph.nodes()[node].key);
}

}  // namespace

OptimizationResult PoseGraphOptimizer::optimize(const PoseGraph& graph, const StopToken& stop) {
  const Stopwatch watch;
  const detail::SingleThreadedBlas guard;
  OptimizationResult result;
  const detail::PoseProblem problem(graph);
  auto poses =
      problem.poses_of(detail::first_estimate(graph, problem, impl_->options, result.factorizations));
  detail::StepControl control;
  control.damping = impl_->options.initial_damping;
  detail::minimize(problem, impl_->equations, poses, impl_->options, control, impl_->pool, stop, result);
  result.poses = problem.isometries(poses);
  describe_graph(graph, impl_->equations.freedom(), result);
  result.seconds = watch.seconds();
  return result;
}

GncResult PoseGraphOptimizer::optimize_gnc(const PoseGraph& graph, const GncOptions& options,
                                           const StopToken& stop) {
  validate(options);
  const Stopwatch watch;
  const detail::SingleThreadedBlas guard;
  GncResult result;
  detail::PoseProblem problem(graph);
  auto poses = problem.poses_of(
      detail::first_estimate(graph, problem, impl_->options, result.optimization.factorizations));
  const detail::Freedom freedom = detail::solve_gnc(graph, problem, impl_->equations, poses, impl_->options,
                                                    options, impl_->pool, stop, result);
  result.optimization.poses = problem.isometries(poses);
  describe_graph(graph, freedom, result.optimization);
  result.optimization.seconds = watch.seconds();
  return result;
}

OptimizationResult optimize(const PoseGraph& graph, const OptimizerOptions& options, const StopToken& stop) {
  return PoseGraphOptimizer(options).optimize(graph, stop);
}

GncResult optimize_gnc(const PoseGraph& graph, const OptimizerOptions& options, const GncOptions& gnc,
                       const StopToken& stop) {
  return PoseGraphOptimizer(options).optimize_gnc(graph, gnc, stop);
}

double graph_cost(const PoseGraph& graph) {
  const detail::PoseProblem problem(graph);
  ThreadPool pool(1);
  std::vector<Vector6d> residuals;
  return problem.cost(problem.poses_of(graph.poses()), pool, residuals);
}

Vector6d edge_residual(const Edge& edge, const Eigen::Isometry3d& T_w_from, const Eigen::Isometry3d& T_w_to) {
  return se3::log(edge.T_from_to.inverse() * T_w_from.inverse() * T_w_to);
}

}  // namespace loopwise
