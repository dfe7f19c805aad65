// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/gnc.hpp>

#include <algorithm>
#include <cmath>

#include <loopwise/core/error.hpp>

#include "gnc_solver.hpp"
#include "minimize.hpp"

namespace loopwise {

EnumNames<RobustKernel> enum_names(RobustKernel) {
  return {{RobustKernel::kGncTls, "gnc_tls"},
          {RobustKernel::kTls, "tls"},
          {RobustKernel::kCauchy, "cauchy"},
          {RobustKernel::kGemanMcClure, "geman_mcclure"}};
}

namespace {

/// Regularised lower incomplete gamma function P(a, x): series below a + 1, continued fraction above.
double gamma_p(double a, double x) {
  if (x <= 0.0) return 0.0;
  const double front = std::exp(a * std::log(x) - x - std::lgamma(a));
  if (x < a + 1.0) {
    double term = 1.0 / a, sum = term;
    for (int n = 1; n < 10000 && term > 1e-17 * sum; ++n) {
      term *= x / (a + n);
      sum += term;
    }
    return front * sum;
  }
  double b = x + 1.0 - a, c = 1e300, d = 1.0 / b, h = d;
  for (int n = 1; n < 10000; ++n) {
    const double an = -n * (n - a);
    b += 2.0;
    d = an * d + b;
    d = 1.0 / (std::abs(d) < 1e-300 ? 1e-300 : d);
    c = b + an / c;
    if (std::abs(c) < 1e-300) c = 1e-300;
    const double factor = d * c;
    h *= factor;
    if (std::abs(factor - 1.0) < 1e-16) break;
  }
  return 1.0 - front * h;
}

}  // namespace

double chi_squared_quantile(double probability, int degrees_of_freedom) {
  if (!(probability > 0.0 && probability < 1.0)) throw OptionError("probability must lie in (0, 1)");
  if (degrees_of_freedom < 1) throw OptionError("degrees of freedom must be positive");
  const double a = 0.5 * degrees_of_freedom;
  double low = 0.0, high = 1.0;
  while (gamma_p(a, 0.5 * high) < probability) high *= 2.0;
  for (int i = 0; i < 200 && high - low > 1e-15 * high; ++i) {
    const double middle = 0.5 * (low + high);
    (gamma_p(a, 0.5 * middle) < probability ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

namespace detail {

void solve_gnc(const PoseGraph& graph, PoseProblem& problem, NormalEquations& equations,
               std::vector<Pose>& poses, const OptimizerOptions& options, const GncOptions& gnc,
               ThreadPool& pool, const StopToken& stop, GncResult& result) {
  const double c2 = chi_squared_quantile(gnc.inlier_probability, 6);
  std::vector<std::size_t> closures;
  for (std::size_t k = 0; k < problem.edges(); ++k) {
    problem.weight[k] = 1.0;
    if (!known_inlier(graph.edges()[k])) closures.push_back(k);
  }
  std::vector<double> r2(closures.size());
  const auto evaluate = [&] {
    for (std::size_t i = 0; i < closures.size(); ++i) r2[i] = problem.squared_residual(closures[i], poses);
  };
  evaluate();
  double largest = 0.0;
  for (const double r : r2) largest = std::max(largest, r);
  double mu = c2 / (2.0 * largest - c2);
  StepControl control;
  control.max_accepted = gnc.steps_per_iteration;
  control.damping = options.initial_damping;
  OptimizationResult total;
  total.cost_initial = problem.cost(poses, pool);
  for (int outer = 0; mu > 0.0 && outer < gnc.max_outer_iterations; ++outer) {
    ++result.outer_iterations;
    bool settled = true;
    const double low = mu / (mu + 1.0) * c2, high = (mu + 1.0) / mu * c2;
    std::size_t active = 0;
    for (std::size_t i = 0; i < closures.size(); ++i) {
      double w = r2[i] <= low ? 1.0 : r2[i] >= high ? 0.0 : std::sqrt(c2 / r2[i] * mu * (mu + 1.0)) - mu;
      w = std::clamp(w, 0.0, 1.0);
      if (w > gnc.weight_tolerance && w < 1.0 - gnc.weight_tolerance) settled = false;
      if (w <= gnc.weight_tolerance) w = 0.0;
      problem.weight[closures[i]] = w;
      active += w > 0;
    }
    OptimizationResult step;
    minimize(problem, equations, poses, options, control, pool, stop, step);
    total.iterations += step.iterations;
    total.factorizations += step.factorizations;
    evaluate();
    if (settled || step.termination == Termination::kStopped) break;
    mu *= gnc.mu_step;
  }
  // Truncated least squares proper: full weight within the threshold, none beyond, until it reproduces
  // itself.
  for (int round = 0; round < 10; ++round) {
    bool changed = round == 0;
    for (std::size_t i = 0; i < closures.size(); ++i) {
      const double w = r2[i] <= c2 ? 1.0 : 0.0;
      if (problem.weight[closures[i]] != w) changed = true;
      problem.weight[closures[i]] = w;
    }
    if (!changed) break;
    OptimizationResult step;
    StepControl full;
    minimize(problem, equations, poses, options, full, pool, stop, step);
    step.iterations += total.iterations;
    step.factorizations += total.factorizations;
    step.cost_initial = total.cost_initial;
    total = step;
    evaluate();
  }
  const int factorizations = result.optimization.factorizations;
  result.optimization = total;
  result.optimization.factorizations += factorizations;
  result.weights.assign(problem.weight.begin(),
                        problem.weight.begin() + static_cast<std::ptrdiff_t>(problem.edges()));
  result.truncated_cost = 0.0;
  for (std::size_t k = 0; k < problem.factors(); ++k) {
    result.truncated_cost += 0.5 * problem.squared_residual(k, poses);
  }
  for (std::size_t i = 0; i < closures.size(); ++i) {
    result.truncated_cost += 0.5 * (std::min(r2[i], c2) - r2[i]);
    ++(problem.weight[closures[i]] > 0.5 ? result.inliers : result.outliers);
  }
}

}  // namespace detail
}  // namespace loopwise
