// SPDX-License-Identifier: BSD-3-Clause
#include "minimize.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <loopwise/core/error.hpp>

namespace loopwise::detail {
namespace {

/// Damping after the first refused step, and the bound beyond which steps are too short to matter.
constexpr double kFirstDamping = 1e-4;
constexpr double kLargestDamping = 1e12;
/// Damping below this is replaced by 0: a Gauss-Newton step.
constexpr double kSmallestDamping = 1e-9;
/// Damping that keeps undetermined directions in place, if there are some. It hardly shortens the step along
/// the others, which therefore counts as a Gauss-Newton step.
constexpr double kHoldingDamping = 1e-8;

/// A step may reuse the factor of the previous step if its predicted decrease is below kReuseBelow of the
/// cost, and below kReuseContraction of the previous step's predicted decrease.
constexpr double kReuseBelow = 1e-2;
constexpr double kReuseContraction = 0.25;

/// A step is tried again with a shorter length if it lowers the cost by less than kPoorDecrease of the
/// prediction. The length is at least kShortestFraction of the step.
constexpr double kPoorDecrease = 0.4;
constexpr double kShortestFraction = 0.05;

double largest(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff();
}

std::string describe(Termination termination, const OptimizationResult& r) {
  std::ostringstream out;
  out.exceptions(std::ios::badbit);  // an allocation failure throws instead of leaving half a message
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

class Minimizer {
 public:
  Minimizer(const PoseProblem& problem, NormalEquations& equations, std::vector<Pose>& poses,
            const OptimizerOptions& options, StepControl& control, ThreadPool& pool, const StopToken& stop,
            OptimizationResult& result)
      : problem_(problem),
        equations_(equations),
        hessian_(equations.hessian()),
        poses_(poses),
        options_(options),
        control_(control),
        pool_(pool),
        stop_(stop),
        result_(result),
        least_damping_(control.damping == kHoldingDamping ? kHoldingDamping : 0.0) {}

  void run() {
    cost_ = problem_.cost(poses_, pool_, residuals_);
    if (!std::isfinite(cost_)) throw InputError("the cost of the first estimate is not finite");
    result_.cost_initial = cost_;
    equations_.set_structure(problem_);
    finish(hessian_.variables() == 0 ? Termination::kNothingToDo : iterate());
  }

 private:
  /// Whether the step with this prediction is the last one: it is below the tolerances.
  [[nodiscard]] bool small(const IterationRecord& record) const {
    if (!is_damped(record) && (record.step <= options_.step_tolerance || record.predicted < control_.enough))
      return true;
    return record.predicted <= options_.cost_tolerance * cost_ &&
           (record.gradient <= options_.gradient_tolerance * result_.gradient_initial ||
            record.predicted <= 1e-15 * cost_);
  }

  [[nodiscard]] bool is_damped(const IterationRecord& record) const {
    return record.damping > least_damping_;
  }

  Termination iterate() {
    bool linearized = false;
    int accepted = 0;
    for (int iteration = 0;; ++iteration) {
      if (stop_.stop_requested()) return Termination::kStopped;
      if (!linearized) {
        equations_.linearize(problem_, poses_, residuals_, pool_);
        diagonal_ = hessian_.matrix().diagonal();
        linearized = gradient_is_current_ = true;
        result_.gradient = largest(equations_.gradient());
        if (iteration == 0) result_.gradient_initial = result_.gradient;
        if (result_.gradient == 0.0) return Termination::kConverged;
      }
      if (iteration >= options_.max_iterations || accepted >= control_.max_accepted)
        return Termination::kMaxIterations;
      if (control_.damping > kLargestDamping) return Termination::kNoProgress;

      IterationRecord record = begin_record();
      if (!factorize()) {
        if (record.damping == 0.0) {
          hold_undetermined(record);
        } else {
          refuse(record);
        }
        continue;
      }
      Eigen::VectorXd step = solve();
      record.step = largest(step);
      record.predicted = 0.5 * (step.dot(added_.cwiseProduct(step)) - equations_.gradient().dot(step));
      const bool last = small(record);
      try_step(step, record);
      if (!last && record.decrease < kPoorDecrease * record.predicted) try_shorter(step, record);
      if (record.accepted) {
        linearized = false;
        growth_ = 2.0;
        ++accepted;
        const double ratio = record.decrease / record.predicted;
        control_.damping *= std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * ratio - 1.0, 3));
        if (control_.damping < kSmallestDamping) control_.damping = 0.0;
        control_.damping = std::max(control_.damping, least_damping_);
        result_.trace.push_back(record);
      }
      if (last) {
        if (!record.accepted) result_.trace.push_back(record);
        return Termination::kConverged;
      }
      if (!record.accepted) {
        refuse(record);
      } else if (!is_damped(record) && accepted < control_.max_accepted &&
                 record.predicted <= kReuseBelow * cost_ && reuse_factor(iteration)) {
        return Termination::kConverged;
      }
    }
  }

  /// Near the minimum the last factor is nearly exact, and using it again costs far less than a new one.
  /// Takes steps with it as long as their predicted decrease contracts. \returns true if this led to
  /// convergence.
  bool reuse_factor(int& iteration) {
    double last_predicted = std::numeric_limits<double>::infinity();
    while (iteration + 1 < options_.max_iterations && !stop_.stop_requested()) {
      equations_.linearize_gradient(problem_, poses_, residuals_);
      gradient_is_current_ = true;
      result_.gradient = largest(equations_.gradient());
      Eigen::VectorXd step = solve();
      IterationRecord record;
      record.gradient = result_.gradient;
      record.cost = cost_;
      record.step = largest(step);
      record.predicted = -0.5 * equations_.gradient().dot(step);
      if (!(record.predicted <= kReuseBelow * cost_) || record.predicted > kReuseContraction * last_predicted)
        return false;
      const bool last = small(record);
      record.iteration = ++result_.iterations;
      ++iteration;
      try_step(step, record);
      result_.trace.push_back(record);
      if (last) return true;
      if (!record.accepted) return false;
      last_predicted = record.predicted;
    }
    return false;
  }

  IterationRecord begin_record() {
    IterationRecord record;
    record.iteration = ++result_.iterations;
    record.gradient = result_.gradient;
    record.damping = control_.damping;
    record.cost = cost_;
    return record;
  }

  bool factorize() {
    const double damping = control_.damping;
    added_ = damping * diagonal_;
    // A direction without a factor has a zero diagonal; any positive value keeps it in place.
    if (damping > 0.0) added_ = added_.cwiseMax(damping * std::max(1e-12 * diagonal_.maxCoeff(), 1e-300));
    hessian_.matrix().set_diagonal(diagonal_ + added_);
    ++result_.factorizations;
    // A damped matrix may be nearly singular. An undamped one must not be: it would give a step along an
    // undetermined direction.
    const double least = damping > 0.0 ? std::numeric_limits<double>::min() : kSingularPivot;
    const bool sound = hessian_.factorize(&pool_) && hessian_.smallest_pivot().first >= least;
    if (!sound && damping < kFirstDamping) result_.underdetermined = true;
    return sound;
  }

  [[nodiscard]] Eigen::VectorXd solve() const {
    Eigen::VectorXd step = -equations_.gradient();
    hessian_.solve(step);
    return step;
  }

  /// Takes the step if it lowers the cost.
  void try_step(const Eigen::VectorXd& step, IterationRecord& record) {
    std::vector<Pose> trial = equations_.moved(poses_, step);
    const double cost = problem_.cost(trial, pool_, trial_residuals_);
    record.cost = cost;
    record.decrease = cost_ - cost;
    record.accepted = std::isfinite(cost) && cost < cost_;
    if (!record.accepted) return;
    start_.swap(poses_);
    poses_.swap(trial);
    gradient_is_current_ = false;
    residuals_.swap(trial_residuals_);
    cost_ = cost;
  }

  /// The step passed the minimum along its direction. A parabola through the cost, its slope and the cost at
  /// the end of the step predicts that minimum. This takes one more evaluation instead of another
  /// factorisation.
  void try_shorter(const Eigen::VectorXd& step, IterationRecord& record) {
    if (!std::isfinite(record.cost)) return;
    const double slope = equations_.gradient().dot(step);  // negative
    const double before = record.accepted ? record.cost + record.decrease : cost_;
    const double curvature = record.cost - before - slope;
    const double fraction = -0.5 * slope / curvature;
    if (!(curvature > 0.0) || fraction < kShortestFraction) return;
    std::vector<Pose> trial = equations_.moved(record.accepted ? start_ : poses_, fraction * step);
    const double cost = problem_.cost(trial, pool_, trial_residuals_);
    if (!(std::isfinite(cost) && cost < cost_)) return;
    record.cost = cost;
    record.decrease = before - cost;
    record.step *= fraction;
    record.accepted = true;
    poses_.swap(trial);
    gradient_is_current_ = false;
    residuals_.swap(trial_residuals_);
    cost_ = cost;
  }

  /// The factors leave directions undetermined.
  void hold_undetermined(const IterationRecord& record) {
    control_.damping = least_damping_ = kHoldingDamping;
    result_.trace.push_back(record);
  }

  void refuse(const IterationRecord& record) {
    control_.damping = std::max(kFirstDamping, control_.damping * growth_);
    growth_ *= 2.0;
    result_.trace.push_back(record);
  }

  void finish(Termination termination) {
    if (!gradient_is_current_) equations_.linearize_gradient(problem_, poses_, residuals_);
    result_.cost = cost_;
    result_.gradient = largest(equations_.gradient());
    set_termination(termination, result_);
  }

  const PoseProblem& problem_;
  NormalEquations& equations_;
  BlockCholesky& hessian_;
  std::vector<Pose>& poses_;
  const OptimizerOptions& options_;
  StepControl& control_;
  ThreadPool& pool_;
  const StopToken& stop_;
  OptimizationResult& result_;
  double least_damping_;  // above 0 if the factors leave directions undetermined

  double cost_ = 0.0;
  double growth_ = 2.0;
  bool gradient_is_current_ = false;  // whether the gradient in the equations is that at poses_
  std::vector<Pose> start_;           // of the last accepted step
  std::vector<Vector6d> residuals_, trial_residuals_;
  Eigen::VectorXd diagonal_, added_;
};

}  // namespace

void set_termination(Termination termination, OptimizationResult& result) {
  result.termination = termination;
  result.converged = termination == Termination::kConverged || termination == Termination::kNothingToDo;
  result.message = describe(termination, result);
}

void minimize(const PoseProblem& problem, NormalEquations& equations, std::vector<Pose>& poses,
              const OptimizerOptions& options, StepControl& control, ThreadPool& pool, const StopToken& stop,
              OptimizationResult& result) {
  Minimizer(problem, equations, poses, options, control, pool, stop, result).run();
}

}  // namespace loopwise::detail
