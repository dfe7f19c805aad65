// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/gnc.hpp>

#include <algorithm>
#include <cmath>

#include <loopwise/core/error.hpp>

#include "gnc_solver.hpp"
#include "initialization.hpp"
#include "innovation.hpp"
#include "minimize.hpp"

namespace loopwise {

EnumNames<RobustKernel> enum_names(RobustKernel) {
  return {{RobustKernel::kGncTls, "gnc_tls"},
          {RobustKernel::kTls, "tls"},
          {RobustKernel::kCauchy, "cauchy"},
          {RobustKernel::kGemanMcClure, "geman_mcclure"}};
}

namespace {

/// log Γ(n/2), by Γ(x + 1) = x Γ(x) from 1 or Γ(½) = √π. std::lgamma() writes to a variable that all threads
/// share.
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

/// What the known inliers alone rule out.
struct Gross {
  std::vector<char> aside;  ///< By edge
  double scale = 1.0;       ///< Of the noise against what information says, squared; at most 1
};

/// Finds the closures to put aside before anything is factorised. The test is on the innovation d²
/// (innovation.hpp), whose threshold assumes that information is honest. Where it is pessimistic by far
/// (parking-garage: by 10⁶), true closures are far below the threshold and false ones may be, too; so the
/// noise is first measured on the lower quartile of d², which half of the closures being false does not
/// spoil, and the threshold follows it down, with a margin for heavy tails. It never follows it up. Closures
/// that repeat the odometry to within rounding (made from it, or registered from the same scans) say nothing
/// of the noise and are not counted: a quarter of them would take the threshold to 0, and all others with it.
Gross find_gross(const PoseGraph& graph, const OdometryForest& forest, double probability,
                 double odometry_margin = 1.0) {
  constexpr double kMargin = 25.0;
  constexpr std::size_t kFewest = 8;
  // Less is no noise: by information pessimistic by 10⁶ one true closure in 50 000 has so little. The scale
  // is therefore 7e-7 at least.
  constexpr double kLeast = 1e-7;
  Gross gross{std::vector<char>(graph.edges().size(), 0)};
  if (probability >= 1.0) return gross;
  const std::vector<double> d2 = innovations(graph, forest);
  std::vector<double> known;
  for (const double d : d2) {
    if (d >= kLeast) known.push_back(d);
  }
  if (known.size() >= kFewest) {
    const auto quartile = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 4);
    std::nth_element(known.begin(), quartile, known.end());
    gross.scale = std::min(1.0, kMargin * *quartile / chi_squared_quantile(0.25, 6));
  }
  const double threshold =
      odometry_margin * odometry_margin * gross.scale * chi_squared_quantile(probability, 6);
  for (std::size_t k = 0; k < d2.size(); ++k) gross.aside[k] = d2[k] > threshold ? 1 : 0;
  return gross;
}

/// Beyond this multiple of c² a residual is as good as infinite: graduation starts no farther out.
constexpr double kFarthestStart = 1e6;
/// Rounds of plain truncated least squares at the end; each lowers the truncated cost, so two or three do.
constexpr int kTruncatedRounds = 20;
/// Times that closures are let in again to see whether that lowers the truncated cost.
constexpr int kGrowthAttempts = 30;
constexpr double kLeastGain = 1e-9;

class RobustSolver {
 public:
  RobustSolver(const PoseGraph& graph, const OdometryForest& forest, const Gross& gross, PoseProblem& problem,
               NormalEquations& equations, const std::vector<Pose>& start, std::vector<Pose>& poses,
               const OptimizerOptions& options, const GncOptions& gnc, ThreadPool& pool,
               const StopToken& stop)
      : problem_(problem),
        equations_(equations),
        poses_(poses),
        start_(start),
        options_(options),
        gnc_(gnc),
        pool_(pool),
        stop_(stop),
        gross_(gross),
        neighbours_(graph, forest),
        c2_(chi_squared_quantile(gnc.inlier_probability, 6)) {
    for (std::size_t k = 0; k < problem.edges(); ++k) {
      problem.weight[k] = 1.0;
      if (!known_inlier(graph.edges()[k])) closures_.push_back(k);
    }
    r2_.resize(closures_.size());
    std::vector<Vector6d> residuals;
    total_.cost_initial = problem.cost(poses, pool, residuals);
    if (!std::isfinite(total_.cost_initial)) throw InputError("the cost of the first estimate is not finite");
    evaluate();
  }

  void solve(GncResult& result) {
    switch (gnc_.kernel) {
      case RobustKernel::kGncTls:
        graduate();
        truncate();
        grow();
        break;
      case RobustKernel::kTls:
        truncate();
        grow();
        break;
      case RobustKernel::kCauchy:
      case RobustKernel::kGemanMcClure:
        reweight();
        break;
    }
    report(result);
  }

 private:
  void evaluate() {
    for (std::size_t i = 0; i < closures_.size(); ++i)
      r2_[i] = problem_.squared_residual(closures_[i], poses_);
  }

  /// Out of the question for now; it comes back when the estimate makes it fit.
  [[nodiscard]] bool set_aside(std::size_t i) const {
    return gross_.aside[closures_[i]] != 0 && r2_[i] > c2_;
  }

  /// Sets the closures' weights; one within the tolerance of 0 leaves the structure. \returns the largest
  /// change.
  template <class Weight>
  double set_weights(Weight&& weight) {
    double change = 0.0;
    for (std::size_t i = 0; i < closures_.size(); ++i) {
      double w = set_aside(i) ? 0.0 : weight(r2_[i]);
      if (w <= gnc_.weight_tolerance) w = 0.0;
      change = std::max(change, std::abs(w - problem_.weight[closures_[i]]));
      problem_.weight[closures_[i]] = w;
    }
    return change;
  }

  void descend(StepControl& control) {
    OptimizationResult part;
    minimize(problem_, equations_, poses_, options_, control, pool_, stop_, part);
    part.cost_initial = total_.cost_initial;
    part.factorizations += total_.factorizations;
    for (IterationRecord& record : part.trace) record.iteration += total_.iterations;
    part.iterations += total_.iterations;
    total_.trace.insert(total_.trace.end(), part.trace.begin(), part.trace.end());
    part.trace = std::move(total_.trace);
    total_ = std::move(part);
    evaluate();
  }

  /// To the minimum for the weights as they are.
  void descend_fully() {
    StepControl control;
    control.damping = options_.initial_damping;
    descend(control);
    bring_back();
  }

  /// Asked to end, and so with work left undone, whatever the last descent came to.
  [[nodiscard]] bool stopped() {
    stopped_ = stopped_ || stop_.stop_requested();
    return stopped_;
  }

  /// Yang et al. 2020, §IV, from the residuals of the first estimate rather than of a solution with all
  /// closures in: that solution is what false closures spoil, and it costs an almost dense factorisation.
  void graduate() {
    double largest = 0.0;
    for (std::size_t i = 0; i < r2_.size(); ++i) {
      if (!set_aside(i)) largest = std::max(largest, r2_[i]);
    }
    double mu = c2_ / (2.0 * std::min(largest, kFarthestStart * c2_) - c2_);
    StepControl control;
    control.max_accepted = gnc_.steps_per_iteration;
    control.damping = options_.initial_damping;
    while (mu > 0.0 && outer_ < gnc_.max_outer_iterations && !stopped()) {
      ++outer_;
      const double full = mu / (mu + 1.0) * c2_, none = (mu + 1.0) / mu * c2_;
      bool settled = true;
      set_weights([&](double r2) {
        if (r2 <= full) return 1.0;
        if (r2 >= none) return 0.0;
        const double w = std::clamp(std::sqrt(c2_ / r2 * mu * (mu + 1.0)) - mu, 0.0, 1.0);
        if (w > gnc_.weight_tolerance && w < 1.0 - gnc_.weight_tolerance) settled = false;
        return w;
      });
      descend(control);
      if (settled) break;
      mu *= gnc_.mu_step;
    }
  }

  /// Full weight within the threshold, none beyond, the minimum for these weights, until they reproduce
  /// themselves.
  void truncate(bool at_minimum = false) {
    for (int round = 0; round < kTruncatedRounds && !stopped(); ++round) {
      const double change = set_weights([&](double r2) { return r2 <= c2_ ? 1.0 : 0.0; });
      if (change == 0.0 && (round > 0 || at_minimum)) break;
      if (gnc_.kernel == RobustKernel::kTls) ++outer_;
      descend_fully();
    }
  }

  /// Lets closures in that were put aside but agree with the kept ones around them: those with d² ≤ c², by
  /// the noise as measured. To let one in costs at least ½d² to first order, to leave it out ½c²: the others
  /// are not worth a try, and these stay if the truncated cost is the lower for it. Inliers thus spread from
  /// where odometry was sure of them to where it no longer is.
  void grow() {
    if (!gnc_.growth) return;
    std::vector<char> tried(closures_.size(), 0);
    int attempts = 0;
    while (!stopped()) {
      std::vector<std::size_t> agreeing = agreeing_with_kept(tried);
      bool better = false;
      while (!agreeing.empty() && !better && attempts++ < kGrowthAttempts && !stopped()) {
        better = let_in(agreeing);
        if (!better) agreeing.resize(agreeing.size() == 1 ? 0 : (agreeing.size() + 3) / 4);
      }
      if (!better) break;
      for (const std::size_t i : agreeing) tried[i] = 1;
    }
  }

  /// The minimum with these closures too; if its truncated cost is not lower everything is as before.
  bool let_in(const std::vector<std::size_t>& closures) {
    const std::vector<Pose> poses = poses_;
    const std::vector<double> weights = problem_.weight;
    const double cost = truncated_cost();
    for (const std::size_t i : closures) problem_.weight[closures_[i]] = 1.0;
    descend_fully();
    truncate(true);
    if (!stopped() && truncated_cost() < cost * (1.0 - kLeastGain)) return true;
    poses_ = poses;
    problem_.weight = weights;
    descend_fully();  // so that equations, cost and gradient are those of the weights
    return false;
  }

  /// By closure; those of which the kept ones are surest come first, and no more than are kept.
  std::vector<std::size_t> agreeing_with_kept(const std::vector<char>& tried) {
    std::vector<std::size_t> kept, aside;
    for (std::size_t i = 0; i < closures_.size(); ++i) {
      if (problem_.weight[closures_[i]] > 0.5) kept.push_back(closures_[i]);
      if (set_aside(i) && tried[i] == 0) aside.push_back(i);
    }
    if (aside.empty()) return {};
    neighbours_.set_kept(kept);
    std::vector<std::size_t> agreeing;
    std::vector<double> variance(closures_.size());
    for (const std::size_t i : aside) {
      if (stopped()) return {};
      const auto innovation = neighbours_(closures_[i], problem_.residual(closures_[i], poses_));
      variance[i] = innovation.variance;
      if (innovation.d2 <= gross_.scale * c2_) agreeing.push_back(i);
    }
    std::stable_sort(agreeing.begin(), agreeing.end(),
                     [&](std::size_t a, std::size_t b) { return variance[a] < variance[b]; });
    if (agreeing.size() > kept.size()) agreeing.resize(kept.size());
    return agreeing;
  }

  void reweight() {
    StepControl control;
    control.max_accepted = gnc_.steps_per_iteration;
    control.damping = options_.initial_damping;
    bool settled = false;
    for (; !settled && outer_ < gnc_.max_outer_iterations && !stopped(); ++outer_) {
      settled = set_weights([&](double r2) {
                  const double w = 1.0 / (1.0 + r2 / c2_);
                  return gnc_.kernel == RobustKernel::kCauchy ? w : w * w;
                }) < gnc_.weight_tolerance;
      descend(control);
    }
    StepControl last;
    if (!stopped()) descend(last);
    bring_back();
  }

  /// A component that lost its last tie to a prior may have been moved before it did: its held node goes back
  /// to the first estimate and takes the component along, at no cost.
  void bring_back() {
    const Freedom& freedom = equations_.freedom();
    for (const std::size_t held : freedom.held) {
      const Pose& now = poses_[held];
      const Pose& then = start_[held];
      const Eigen::Matrix3d R = then.R * now.R.transpose();
      const Eigen::Vector3d t = then.t - R * now.t;
      if (R == Eigen::Matrix3d::Identity() && t.isZero()) continue;
      for (std::size_t i = 0; i < problem_.nodes(); ++i) {
        if (freedom.component[i] != held) continue;
        poses_[i].R = R * poses_[i].R;
        poses_[i].t = R * poses_[i].t + t;
      }
    }
    // So does a node that lost its last factor altogether.
    for (std::size_t i = 0; i < problem_.nodes(); ++i) {
      if (freedom.component[i] == Freedom::kFixed) poses_[i] = start_[i];
    }
    evaluate();
  }

  void report(GncResult& result) {
    total_.factorizations += result.optimization.factorizations;  // of the first estimate
    if (stopped_ || total_.termination == Termination::kStopped)
      set_termination(Termination::kStopped, total_);
    result.optimization = std::move(total_);
    result.outer_iterations = outer_;
    result.weights.assign(problem_.weight.begin(),
                          problem_.weight.begin() + static_cast<std::ptrdiff_t>(problem_.edges()));
    for (const std::size_t k : closures_) ++(problem_.weight[k] > 0.5 ? result.inliers : result.outliers);
    result.truncated_cost = truncated_cost();
  }

  [[nodiscard]] double truncated_cost() const {
    double cost = problem_.auxiliary_cost(poses_);
    auto closure = closures_.begin();  // ascending
    for (std::size_t k = 0; k < problem_.factors(); ++k) {
      const double r2 = problem_.squared_residual(k, poses_);
      const bool in_doubt = closure != closures_.end() && *closure == k;
      if (in_doubt) ++closure;
      cost += 0.5 * (in_doubt ? std::min(r2, c2_) : r2);
    }
    return cost;
  }

  PoseProblem& problem_;
  NormalEquations& equations_;
  std::vector<Pose>& poses_;
  const std::vector<Pose>& start_;  // where what nothing holds stays
  const OptimizerOptions& options_;
  const GncOptions& gnc_;
  ThreadPool& pool_;
  const StopToken& stop_;
  const Gross& gross_;
  NeighbourInnovations neighbours_;
  const double c2_;
  std::vector<std::size_t> closures_;  // factors in doubt
  std::vector<double> r2_;             // by closure
  OptimizationResult total_;
  int outer_ = 0;
  bool stopped_ = false;
};

}  // namespace

namespace {

/// Takes the result of a second start if it is better; what both took is counted. \returns whether it is.
bool keep_better(GncResult& first, GncResult&& second) {
  const bool better = second.truncated_cost < first.truncated_cost;
  const bool stopped = second.optimization.termination == Termination::kStopped;
  second.outer_iterations += first.outer_iterations;
  second.optimization.iterations += first.optimization.iterations;
  second.optimization.factorizations += first.optimization.factorizations;
  second.optimization.cost_initial = first.optimization.cost_initial;
  if (better) {
    first = std::move(second);
  } else {
    first.outer_iterations = second.outer_iterations;
    first.optimization.iterations = second.optimization.iterations;
    first.optimization.factorizations = second.optimization.factorizations;
  }
  if (stopped) set_termination(Termination::kStopped, first.optimization);
  return better;
}

}  // namespace

namespace {

/// Everything that starts of one robust problem share.
struct RobustProblem {
  const PoseGraph& graph;
  const OdometryForest& forest;
  const std::vector<Pose>& start;
  const OptimizerOptions& options;
  const GncOptions& gnc;
  ThreadPool& pool;
  const StopToken& stop;
};

/// A result and what it is the components of.
struct Solution {
  std::vector<Pose> poses;
  GncResult result;
  Freedom freedom;
};

Solution solve_from(const RobustProblem& given, const Gross& gross, PoseProblem& problem,
                    std::vector<Pose> poses, int factorizations) {
  NormalEquations equations(given.options.factorization);
  Solution out;
  out.poses = std::move(poses);
  out.result.optimization.factorizations = factorizations;
  RobustSolver(given.graph, given.forest, gross, problem, equations, given.start, out.poses, given.options,
               given.gnc, given.pool, given.stop)
      .solve(out.result);
  out.freedom = equations.freedom();
  return out;
}

/// From the chordal estimate of the closures that odometry does not rule out.
Solution solve_from_chordal(const RobustProblem& given, const Gross& gross) {
  PoseProblem problem(given.graph);
  for (std::size_t k = 0; k < problem.edges(); ++k) problem.weight[k] = gross.aside[k] != 0 ? 0.0 : 1.0;
  OptimizerOptions chordal = given.options;
  chordal.initialization = Initialization::kChordal;
  int factorizations = 0;
  std::vector<Pose> poses = problem.poses_of(first_estimate(given.graph, problem, chordal, factorizations));
  return solve_from(given, gross, problem, std::move(poses), factorizations);
}

/// Closures that odometry rules out and the result leaves out.
bool leaves_out(const Gross& gross, const GncResult& result) {
  for (std::size_t k = 0; k < gross.aside.size(); ++k) {
    if (gross.aside[k] != 0 && result.weights[k] <= 0.5) return true;
  }
  return false;
}

}  // namespace

Freedom solve_gnc(const PoseGraph& graph, PoseProblem& problem, NormalEquations& equations,
                  std::vector<Pose>& poses, const OptimizerOptions& options, const GncOptions& gnc,
                  ThreadPool& pool, const StopToken& stop, GncResult& result) {
  const OdometryForest forest(graph);
  const Gross gross = find_gross(graph, forest, gnc.innovation_probability);
  const std::vector<Pose> start = poses;
  RobustSolver(graph, forest, gross, problem, equations, start, poses, options, gnc, pool, stop)
      .solve(result);
  Freedom freedom = equations.freedom();
  const bool truncates = gnc.kernel == RobustKernel::kGncTls || gnc.kernel == RobustKernel::kTls;
  if (!gnc.second_start || !truncates) return freedom;
  const RobustProblem given{graph, forest, start, options, gnc, pool, stop};
  const auto keep_if_better = [&](Solution&& other) {
    if (!keep_better(result, std::move(other.result))) return false;
    poses = std::move(other.poses);
    freedom = std::move(other.freedom);
    return true;
  };
  // Closures that odometry rules out may be right, and the odometry worse than it says.
  if (leaves_out(gross, result) && !stop.stop_requested()) {
    const Gross fewer = find_gross(graph, forest, gnc.innovation_probability, gnc.odometry_margin);
    if (fewer.aside != gross.aside) {
      PoseProblem again(graph);
      keep_if_better(solve_from(given, fewer, again, start, 0));
    }
  }
  if (result.outliers > 0 && options.initialization != Initialization::kChordal && !stop.stop_requested()) {
    keep_if_better(solve_from_chordal(given, gross));
  }
  if (stop.stop_requested()) set_termination(Termination::kStopped, result.optimization);
  return freedom;
}

}  // namespace detail
}  // namespace loopwise
