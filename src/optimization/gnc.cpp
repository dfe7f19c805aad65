// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/gnc.hpp>

#include <algorithm>
#include <cmath>

#include <loopwise/core/error.hpp>

#include "confirmed_closures.hpp"
#include "gnc_solver.hpp"
#include "minimize.hpp"
#include "robust_starts.hpp"

namespace loopwise {

EnumNames<RobustKernel> enum_names(RobustKernel) {
  return {{RobustKernel::kGncTls, "gnc_tls"},
          {RobustKernel::kTls, "tls"},
          {RobustKernel::kCauchy, "cauchy"},
          {RobustKernel::kGemanMcClure, "geman_mcclure"}};
}

namespace {

/// log Γ(n/2), by Γ(x + 1) = x Γ(x) from Γ(1) = 1 or Γ(½) = √π. std::lgamma() is not used: it writes to a
/// variable that all threads share.
double log_gamma_of_half(int n) {
  constexpr double kHalfLogPi = 0.57236494292470008707;
  double sum = n % 2 == 0 ? 0.0 : kHalfLogPi;
  for (int k = n % 2 == 0 ? 2 : 1; k < n; k += 2) sum += std::log(0.5 * k);
  return sum;
}

/// Regularised lower incomplete gamma function P(n/2, x): series below n/2 + 1, continued fraction above.
double gamma_p(int n_halves, double x) {
  if (x <= 0.0) return 0.0;
  const double a = 0.5 * n_halves;
  const double front = std::exp(a * std::log(x) - x - log_gamma_of_half(n_halves));
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

EnumNames<GncStart> enum_names(GncStart) {
  return {{GncStart::kFirstEstimate, "first_estimate"},
          {GncStart::kConfirmed, "confirmed"},
          {GncStart::kDoubtedOdometry, "doubted_odometry"},
          {GncStart::kChordal, "chordal"},
          {GncStart::kLastResult, "last_result"}};
}

double chi_squared_quantile(double probability, int degrees_of_freedom) {
  if (!(probability > 0.0 && probability < 1.0)) throw OptionError("probability must lie in (0, 1)");
  if (degrees_of_freedom < 1) throw OptionError("degrees of freedom must be positive");
  double low = 0.0, high = 1.0;
  while (gamma_p(degrees_of_freedom, 0.5 * high) < probability) high *= 2.0;
  for (int i = 0; i < 200 && high - low > 1e-15 * high; ++i) {
    const double middle = 0.5 * (low + high);
    (gamma_p(degrees_of_freedom, 0.5 * middle) < probability ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

namespace detail {
namespace {

/// Cost with all weights 1.
double plain_cost(PoseProblem problem, const std::vector<Pose>& poses, ThreadPool& pool) {
  std::fill(problem.weight.begin(), problem.weight.end(), 1.0);
  std::vector<Vector6d> residuals;
  const double cost = problem.cost(poses, pool, residuals);
  if (!std::isfinite(cost)) throw InputError("the cost of the first estimate is not finite");
  return cost;
}

void solve_from_all(const RobustProblem& given, Starts& starts) {
  const auto stopped = [&] { return given.stop.stop_requested(); };
  const bool several = given.gnc.second_start && truncates(given.gnc.kernel);
  if (several && (starts.from_measured_noise() || starts.from_confirmed())) return;
  // Odometry with such noise tests little, so that graduation from its chain may need a thousand steps.
  if (several && starts.has_heavy_tail() && !stopped() && starts.from_chordal()) {
    if (given.gnc.odometry_margin > 1.0 && !stopped()) starts.refine(false);
    return;
  }
  if (!starts.has_solution() || !stopped()) starts.from_first_estimate();
  if (!several) return;
  if (starts.excludes_closures() && given.options.initialization != Initialization::kChordal && !stopped())
    starts.from_chordal();
  if (given.gnc.odometry_margin <= 1.0) return;
  if (!stopped()) starts.rescale_odometry();
  if (starts.excludes_gross_outliers() && !stopped()) starts.from_doubted_odometry();
  if (!stopped()) starts.refine(false);
}

}  // namespace

double truncated_cost(const PoseGraph& graph, const PoseProblem& problem, const std::vector<Pose>& poses,
                      double c2) {
  double cost = problem.auxiliary_cost(poses);
  for (std::size_t k = 0; k < problem.factors(); ++k) {
    const double r2 = problem.squared_residual(k, poses);
    const bool in_doubt = k < problem.edges() && !known_inlier(graph.edges()[k]);
    cost += 0.5 * (in_doubt ? std::min(r2, c2) : r2);
  }
  return cost;
}

Freedom solve_gnc(const PoseGraph& graph, const PoseProblem& problem, NormalEquations& equations,
                  std::vector<Pose>& poses, const WarmStart* warm, const OptimizerOptions& options,
                  const GncOptions& gnc, ThreadPool& pool, const StopToken& stop, GncResult& result,
                  std::size_t* left_out_confirmed, OdometryVariances& variances) {
  const OdometryForest forest =
      joined_forest(graph, chi_squared_quantile(gnc.inlier_probability, graph.degrees_of_freedom()));
  const std::vector<Pose> start = poses;
  const double first_cost = plain_cost(problem, start, pool);
  const RobustProblem given{graph, forest, start, options, gnc, pool, stop};
  Starts starts(given, problem, equations);
  bool fresh = false;
  const bool enough = warm != nullptr && !warm->due && starts.from_last(*warm);
  if (!enough && (!starts.has_solution() || !stop.stop_requested())) {
    // Costs do not decide between the last result and the other starts. False closures that agree with each
    // other may have bent the last result; it costs less with each of them, and the test against odometry no
    // longer excludes them.
    starts.forget();
    solve_from_all(given, starts);
    fresh = true;
  }
  if (left_out_confirmed != nullptr && fresh) *left_out_confirmed = starts.left_out_confirmed();
  starts.report_odometry();
  Solution best = std::move(starts).best();
  const int before = result.optimization.factorizations;
  result = std::move(best.result);
  result.fresh = fresh;
  result.optimization.cost_initial = first_cost;
  result.optimization.factorizations += before;
  if (stop.stop_requested()) set_termination(Termination::kStopped, result.optimization);
  poses = std::move(best.poses);
  variances = std::move(best.odometry_variances);
  return std::move(best.freedom);
}

}  // namespace detail
}  // namespace loopwise
