// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/optimizer.hpp>

#include <algorithm>
#include <optional>
#include <utility>

#include <loopwise/core/clock.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "gnc_solver.hpp"
#include "initialization.hpp"
#include "linalg/blas_threads.hpp"
#include "minimize.hpp"
#include "pose_problem.hpp"

namespace loopwise {

EnumNames<Initialization> enum_names(Initialization) {
  return {{Initialization::kAuto, "auto"},
          {Initialization::kFile, "file"},
          {Initialization::kOdometry, "odometry"},
          {Initialization::kChordal, "chordal"}};
}

EnumNames<Termination> enum_names(Termination) {
  return {{Termination::kConverged, "converged"},
          {Termination::kNothingToDo, "nothing_to_do"},
          {Termination::kMaxIterations, "max_iterations"},
          {Termination::kNoProgress, "no_progress"},
          {Termination::kStopped, "stopped"}};
}

namespace {

/// A robust result from which a later optimisation may continue.
struct LastResult {
  detail::PoseProblem problem;
  std::vector<Key> keys;  // by node
  std::vector<Eigen::Isometry3d> poses;
  std::vector<char> kept;           // by edge
  std::size_t closures_when_fresh;  // at the last optimisation from all starts
  std::size_t left_out_confirmed;   // at that time
  detail::OdometryVariances odometry_variances;
};

std::size_t closures_of(const PoseGraph& graph) {
  return static_cast<std::size_t>(std::count_if(graph.edges().begin(), graph.edges().end(),
                                                [](const Edge& edge) { return !known_inlier(edge); }));
}

/// Whether the first nodes and edges of a graph are those of the last result.
bool continues(const PoseGraph& graph, const detail::PoseProblem& problem, const LastResult& last) {
  if (graph.nodes().size() < last.keys.size() || problem.edges() < last.problem.edges()) return false;
  for (std::size_t i = 0; i < last.keys.size(); ++i) {
    if (graph.nodes()[i].key != last.keys[i]) return false;
  }
  for (std::size_t k = 0; k < last.problem.edges(); ++k) {
    const detail::Pose &now = problem.inverse_measurement(k), &then = last.problem.inverse_measurement(k);
    if (problem.from(k) != last.problem.from(k) || problem.to(k) != last.problem.to(k) || now.t != then.t ||
        now.R != then.R || problem.information(k) != last.problem.information(k))
      return false;
  }
  return true;
}

/// Extends the last result to a graph that continues it; nothing if the graph does not.
std::optional<detail::WarmStart> warm_start(const PoseGraph& graph, const detail::PoseProblem& problem,
                                            const std::optional<LastResult>& last, double growth) {
  if (!last || !continues(graph, problem, *last)) return std::nullopt;
  detail::WarmStart out;
  std::vector<Eigen::Isometry3d> poses = graph.poses();
  std::vector<char> placed(poses.size(), 0);
  for (std::size_t i = 0; i < last->poses.size(); ++i) {
    poses[i] = last->poses[i];
    placed[i] = 1;
  }
  out.poses = problem.poses_of(detail::extended(graph, std::move(poses), std::move(placed)));
  out.known.assign(problem.edges(), 0);
  std::fill_n(out.known.begin(), last->kept.size(), 1);
  out.kept = last->kept;
  out.kept.resize(problem.edges(), 0);
  out.left_out_confirmed = last->left_out_confirmed;
  out.odometry_variances = last->odometry_variances;
  out.due = growth == 0.0 ||
            static_cast<double>(closures_of(graph)) >=
                (1.0 + growth) * static_cast<double>(std::max<std::size_t>(last->closures_when_fresh, 1));
  return out;
}

}  // namespace

struct PoseGraphOptimizer::Impl {
  OptimizerOptions options;
  ThreadPool pool;
  detail::NormalEquations equations;
  std::optional<LastResult> last;

  explicit Impl(const OptimizerOptions& o) : options(o), pool(o.threads), equations(o.factorization) {}

  [[nodiscard]] double cost(const detail::PoseProblem& problem, const std::vector<detail::Pose>& poses) {
    std::vector<Vector6d> residuals;
    return problem.cost(poses, pool, residuals);
  }

  /// Minimises from the first estimate of the lowest cost; if that does not converge, also from the next one.
  /// The lower cost is kept. \returns the poses
  std::vector<detail::Pose> minimize_from_best(const PoseGraph& graph, const detail::PoseProblem& problem,
                                               const StopToken& stop, OptimizationResult& result) {
    int iterations = 0, factorizations = 0;
    auto estimates = detail::ranked_estimates(
        graph, problem, options, true, [&](const auto& poses) { return cost(problem, poses); },
        factorizations);
    std::vector<detail::Pose> best;
    for (detail::FirstEstimate& estimate : estimates) {
      OptimizationResult attempt;
      attempt.initialization = estimate.kind;
      minimize(problem, estimate.poses, stop, attempt);
      iterations += attempt.iterations;
      factorizations += attempt.factorizations;
      const bool stopped = attempt.termination == Termination::kStopped;
      if (best.empty() || attempt.cost < result.cost) {
        result = std::move(attempt);
        best = std::move(estimate.poses);
      }
      if (stopped) detail::set_termination(Termination::kStopped, result);
      if (stopped || result.converged) break;
    }
    result.iterations = iterations;
    result.factorizations = factorizations;
    return best;
  }

  void minimize(const detail::PoseProblem& problem, std::vector<detail::Pose>& poses, const StopToken& stop,
                OptimizationResult& result) {
    detail::StepControl control;
    control.damping = options.initial_damping;
    detail::minimize(problem, equations, poses, options, control, pool, stop, result);
  }
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

/// Sets the fields of the result that describe the graph as a whole.
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
  std::vector<detail::Pose> poses;
  if (impl_->options.initialization == Initialization::kAuto) {
    poses = impl_->minimize_from_best(graph, problem, stop, result);
  } else {
    result.initialization = impl_->options.initialization;
    poses =
        detail::first_estimate(result.initialization, graph, problem, impl_->options, result.factorizations);
    impl_->minimize(problem, poses, stop, result);
  }
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
  const detail::PoseProblem problem(graph);
  const bool may_continue = options.warm_start && detail::truncates(options.kernel);
  const std::optional<detail::WarmStart> warm =
      may_continue ? warm_start(graph, problem, impl_->last, options.warm_growth) : std::nullopt;
  Initialization from = impl_->options.initialization;
  std::vector<detail::Pose> poses;
  if (from == Initialization::kAuto) {
    // The chordal estimate is not a candidate, because false closures distort it; second_start uses it
    // separately.
    const double c2 = chi_squared_quantile(options.inlier_probability, graph.degrees_of_freedom());
    auto estimates = detail::ranked_estimates(
        graph, problem, impl_->options, false,
        [&](const auto& at) { return detail::truncated_cost(graph, problem, at, c2); },
        result.optimization.factorizations);
    from = estimates.front().kind;
    poses = std::move(estimates.front().poses);
  } else {
    poses = detail::first_estimate(from, graph, problem, impl_->options, result.optimization.factorizations);
  }
  std::size_t left_out_confirmed = warm ? warm->left_out_confirmed : 0;
  detail::OdometryVariances variances;
  const detail::Freedom freedom = detail::solve_gnc(
      graph, problem, impl_->equations, poses, warm ? &*warm : nullptr, impl_->options, options, impl_->pool,
      stop, result, may_continue ? &left_out_confirmed : nullptr, variances);
  result.optimization.initialization = from;
  result.optimization.poses = problem.isometries(poses);
  describe_graph(graph, freedom, result.optimization);
  if (may_continue && result.optimization.termination != Termination::kStopped) {
    std::vector<char> kept(problem.edges());
    for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = result.weights[k] > detail::kKept ? 1 : 0;
    const std::size_t when_fresh = result.fresh ? closures_of(graph) : impl_->last->closures_when_fresh;
    impl_->last = LastResult{problem,    graph.keys(),       result.optimization.poses, std::move(kept),
                             when_fresh, left_out_confirmed, std::move(variances)};
  }
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
