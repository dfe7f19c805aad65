// SPDX-License-Identifier: BSD-3-Clause
#include "minimize.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <loopwise/core/error.hpp>

namespace loopwise::detail {
namespace {

/// Damping that the first refused step brings in, and the bound beyond which steps are too short to matter.
constexpr double kFirstDamping = 1e-4;
constexpr double kLargestDamping = 1e12;
/// Damping this small leaves the step a Gauss-Newton one.
constexpr double kSmallestDamping = 1e-9;

double largest(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff();
}

std::string describe(Termination termination, const OptimizationResult& r) {
  std::ostringstream out;
  switch (termination) {
    case Termination::kConverged:
      out << "converged";
      break;
    case Termination::kNothingToDo:
      out << "no factor acts on a free pose";
      break;
    case Termination::kMaxIterations:
      out << "ran out of iterations";
      break;
    case Termination::kNoProgress:
      out << "no step lowers the cost";
      break;
    case Termination::kStopped:
      out << "asked to stop";
      break;
  }
  out << " after " << r.iterations << " iterations, cost " << r.cost << ", largest gradient " << r.gradient;
  if (r.underdetermined) out << "; the factors leave some poses undetermined";
  return out.str();
}

}  // namespace

void minimize(const PoseProblem& problem, NormalEquations& equations, std::vector<Pose>& poses,
              const OptimizerOptions& options, StepControl& control, ThreadPool& pool, const StopToken& stop,
              OptimizationResult& result) {
  double cost = problem.cost(poses, pool);
  if (!std::isfinite(cost)) throw InputError("the cost of the first estimate is not finite");
  result.cost_initial = result.cost = cost;
  equations.set_structure(problem);
  BlockCholesky& hessian = equations.hessian();

  const auto finish = [&](Termination termination) {
    result.termination = termination;
    result.converged = termination == Termination::kConverged || termination == Termination::kNothingToDo;
    result.cost = cost;
    equations.linearize_gradient(problem, poses);
    result.gradient = largest(equations.gradient());
    result.message = describe(termination, result);
  };
  if (hessian.variables() == 0) return finish(Termination::kNothingToDo);

  double& damping = control.damping;
  int accepted = 0;
  double growth = 2.0;
  bool linearized = false;
  Eigen::VectorXd diagonal;
  for (int iteration = 0;; ++iteration) {
    if (stop.stop_requested()) return finish(Termination::kStopped);
    if (!linearized) {
      equations.linearize(problem, poses, pool);
      diagonal = hessian.diagonal();
      linearized = true;
      result.gradient = largest(equations.gradient());
      if (iteration == 0) result.gradient_initial = result.gradient;
      if (result.gradient == 0.0) return finish(Termination::kConverged);
    }
    if (iteration >= options.max_iterations || accepted >= control.max_accepted)
      return finish(Termination::kMaxIterations);
    if (damping > kLargestDamping) return finish(Termination::kNoProgress);

    IterationRecord record;
    record.iteration = ++result.iterations;
    record.gradient = result.gradient;
    record.damping = damping;
    record.cost = cost;
    Eigen::VectorXd added = damping * diagonal;
    if (damping > 0.0) {
      // A direction that no factor touches has a zero diagonal: any positive value holds it in place.
      const double floor = damping * std::max(1e-12 * diagonal.maxCoeff(), 1e-300);
      added = added.cwiseMax(floor);
    }
    hessian.set_diagonal(diagonal + added);
    const bool factorized = hessian.factorize();
    ++result.factorizations;
    const auto refuse = [&] {
      damping = std::max(kFirstDamping, damping * growth);
      growth *= 2.0;
      result.trace.push_back(record);
    };
    if (!factorized || (damping == 0.0 && hessian.smallest_pivot().first < kSingularPivot)) {
      if (damping < 1e-6) result.underdetermined = true;
      refuse();
      continue;
    }
    Eigen::VectorXd step = -equations.gradient();
    hessian.solve(step);
    record.step = largest(step);
    const double slope = -equations.gradient().dot(step);
    record.predicted = 0.5 * (slope + step.dot(added.cwiseProduct(step)));
    std::vector<Pose> trial = equations.moved(poses, step);
    const double trial_cost = problem.cost(trial, pool);
    record.cost = trial_cost;
    record.decrease = cost - trial_cost;

    const bool small = record.predicted <= options.cost_tolerance * cost &&
                       (result.gradient <= options.gradient_tolerance * result.gradient_initial ||
                        record.step <= options.step_tolerance || record.predicted <= 1e-15 * cost);
    record.accepted = std::isfinite(trial_cost) && trial_cost < cost;
    if (record.accepted) {
      const double ratio = record.decrease / record.predicted;
      poses = std::move(trial);
      cost = trial_cost;
      result.cost = cost;
      ++accepted;
      linearized = false;
      growth = 2.0;
      damping *= std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * ratio - 1.0, 3));
      if (damping < kSmallestDamping) damping = 0.0;
      result.trace.push_back(record);
    }
    if (small) {
      if (!record.accepted) result.trace.push_back(record);
      return finish(Termination::kConverged);
    }
    if (!record.accepted) refuse();
  }
}

}  // namespace loopwise::detail
