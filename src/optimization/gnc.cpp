// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/gnc.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include <loopwise/core/error.hpp>

#include "confirmed_closures.hpp"
#include "gnc_solver.hpp"
#include "initialization.hpp"
#include "innovation.hpp"
#include "minimize.hpp"
#include "odometry_scale.hpp"
#include "robust_solver.hpp"

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

/// Costs that differ by less than this share are equal; the result of the earlier start is then kept.
constexpr double kEqual = 1e-9;

/// The confirmed closures start a solution of their own if they are at least kFewestConfirmed of the closures
/// that odometry does not rule out. The other starts follow if this solution loses more than
/// kMostConfirmedLost of them.
constexpr double kFewestConfirmed = 1.0 / 3.0;
constexpr double kMostConfirmedLost = 0.01;
/// A start with closures that the stated odometry rules out may lose this share of the closures kept without
/// them. Closures that agree with each other but not with the others, as from two floors of one plan, would
/// replace more.
constexpr double kMostGivenUp = 0.03;

/// Bound on rounds that estimate odometry's uncertainty and solve with it. Each round admits more closures,
/// which give a better estimate.
constexpr int kScaleRounds = 4;
/// Variance factors whose ratio is below this count as equal.
constexpr double kSameVariance = 1.1;

bool differ(const OdometryVariances& a, const OdometryVariances& b) {
  const auto beyond = [](const OdometryVariances& some, const OdometryVariances& others) {
    return std::any_of(some.begin(), some.end(), [&](const auto& entry) {
      const auto found = others.find(entry.first);
      return entry.second > kSameVariance * (found == others.end() ? 1.0 : found->second);
    });
  };
  return beyond(a, b) || beyond(b, a);
}

/// A result with its poses, the odometry variances used, and the components of the graph.
struct Solution {
  std::vector<Pose> poses;
  OdometryVariances odometry_variances;
  GncResult result;
  Freedom freedom;
};

/// The solutions of one problem from several starts; the one of the lowest truncated cost is kept.
class Starts {
 public:
  Starts(const RobustProblem& given, const PoseProblem& problem, NormalEquations& equations)
      : given_(given),
        problem_(problem),
        equations_(equations),
        chains_(odometry_chains(given.graph)),
        d2_(innovations(given.graph, given.forest)),
        gross_(find_gross_outliers(given.graph, d2_, given.gnc.innovation_probability)) {}

  /// Starts from the last result. \returns false if the result is in doubt, so that the other starts are
  /// needed
  bool from_last(const WarmStart& warm) {
    const OdometryVariances variances = allowed(warm.odometry_variances);
    Scaled scaled(*this, variances);
    PoseProblem& problem = scaled.problem();
    Solution out;
    out.poses = warm.poses;
    out.odometry_variances = variances;
    RobustSolver solver(scaled.given(), gross_, problem, equations_, out.poses);
    const std::vector<char> chosen = solver.plausible(warm.known, warm.kept);
    std::vector<char> is_new(warm.known.size());
    for (std::size_t k = 0; k < is_new.size(); ++k) is_new[k] = warm.known[k] != 0 ? 0 : 1;
    solver.solve_from(chosen, is_new, out.result);
    bool in_doubt = !out.result.optimization.converged;
    for (std::size_t k = 0; k < warm.kept.size(); ++k) {
      in_doubt = in_doubt || (warm.kept[k] != 0 && problem.weight[k] <= kKept);
    }
    in_doubt = in_doubt || !solver.unexplained(is_new).empty();
    if (!in_doubt) {
      const double before = static_cast<double>(warm.left_out_confirmed);
      in_doubt = static_cast<double>(left_out_confirmed(problem)) > (1.0 + given_.gnc.warm_growth) * before;
    }
    out.result.start = GncStart::kLastResult;
    keep_better(std::move(out));
    return !in_doubt;
  }

  /// Starts from the chordal estimate of the confirmed closures. \returns whether the solution is beyond
  /// doubt: the confirmed closures are many, it keeps almost all of them, and it contradicts every closure
  /// that it excludes
  bool from_confirmed() {
    std::vector<char> allowed(gross_.excluded.size());
    for (std::size_t k = 0; k < allowed.size(); ++k) {
      allowed[k] = known_inlier(given_.graph.edges()[k]) || gross_.excluded[k] != 0 ? 0 : 1;
    }
    const std::vector<char> confirmed = confirmed_of(allowed);
    const auto open = std::count(allowed.begin(), allowed.end(), 1);
    const auto seeds = std::count(confirmed.begin(), confirmed.end(), 1);
    if (seeds == 0 || static_cast<double>(seeds) < kFewestConfirmed * static_cast<double>(open)) return false;
    PoseProblem problem = problem_;
    Solution out = chordal_of(problem, confirmed);
    RobustSolver solver(given_, gross_, problem, equations_, out.poses);
    solver.solve_from(confirmed, {}, out.result);
    std::size_t lost = 0;
    for (std::size_t k = 0; k < confirmed.size(); ++k) {
      lost += confirmed[k] != 0 && problem.weight[k] <= kKept ? 1 : 0;
    }
    const bool beyond_doubt = static_cast<double>(lost) <= kMostConfirmedLost * static_cast<double>(seeds) &&
                              solver.unexplained(allowed).empty() && left_out_confirmed(problem) <= lost;
    out.result.start = GncStart::kConfirmed;
    keep_better(std::move(out));
    return beyond_doubt;
  }

  void from_first_estimate() { keep_better(solved_from(gross_, given_.start, GncStart::kFirstEstimate)); }

  /// Starts from the chordal estimate of the closures that odometry does not rule out.
  void from_chordal() {
    std::vector<char> chosen(gross_.excluded.size());
    for (std::size_t k = 0; k < chosen.size(); ++k) chosen[k] = gross_.excluded[k] != 0 ? 0 : 1;
    PoseProblem problem = problem_;
    Solution out = chordal_of(problem, chosen);
    RobustSolver(given_, gross_, problem, equations_, out.poses).solve(out.result);
    out.result.start = GncStart::kChordal;
    keep_better(std::move(out));
  }

  /// Continues from the best solution with odometry as uncertain as its closures show it to be, and admits
  /// closures that then agree: true closures that the stated odometry contradicts. Closures that the
  /// innovation test rules out return only through grow(). Excluded closures do not contribute to the
  /// estimate of the variance factors, so there are two attempts: one starts with the stated odometry, the
  /// other with doubted odometry, which the closures may confirm again. The attempt that keeps more closures
  /// is kept.
  void rescale_odometry() {
    if (best_->result.outliers == 0) {
      refine(true);
      return;
    }
    Solution stated = *best_;
    if (!refine(true) || given_.stop.stop_requested()) return;
    Solution from_stated = std::move(*best_);
    best_ = std::move(stated);
    OdometryVariances inflated;
    for (std::size_t k = 0; k < problem_.edges(); ++k) {
      // As a standard deviation this is the geometric mean of the stated value and the largest allowed one.
      if (given_.graph.edges()[k].kind == EdgeKind::kOdometry)
        inflated[chains_[given_.graph.ends(k).from]] = given_.gnc.odometry_margin;
    }
    const bool finished = solve_with(std::move(inflated)) && refine(true);
    if (finished && from_stated.result.inliers < best_->result.inliers) {
      count_discarded(from_stated.result);
    } else {
      count_discarded(best_->result);
      best_ = std::move(from_stated);
    }
  }

  /// Starts from the first estimate again, with the closures that odometry allows if it is as uncertain as in
  /// the best solution. If that solution takes odometry as stated, the largest allowed uncertainty is used.
  void from_doubted_odometry() {
    const OdometryVariances variances = best_->odometry_variances;
    const double probability = given_.gnc.innovation_probability;
    Scaled scaled(*this, variances);
    const GrossOutliers fewer =
        variances.empty()
            ? find_gross_outliers(given_.graph, d2_, probability, given_.gnc.odometry_margin)
            : find_gross_outliers(given_.graph, innovations(scaled.given().graph, scaled.given().forest),
                                  probability);
    if (fewer.excluded == gross_.excluded) return;
    Solution out;
    out.poses = given_.start;
    out.odometry_variances = variances;
    RobustSolver(scaled.given(), fewer, scaled.problem(), equations_, out.poses).solve(out.result);
    out.result.start = GncStart::kDoubtedOdometry;
    std::size_t kept = 0, lost = 0;
    for (std::size_t k = 0; k < problem_.edges(); ++k) {
      if (known_inlier(given_.graph.edges()[k]) || best_->result.weights[k] <= kKept) continue;
      ++kept;
      lost += out.result.weights[k] <= kKept ? 1 : 0;
    }
    if (static_cast<double>(lost) > kMostGivenUp * static_cast<double>(kept))
      return count_discarded(out.result);
    keep_better(std::move(out));
    if (best_->result.start == GncStart::kDoubtedOdometry) refine(true);
  }

  /// Estimates variance factors at the best solution and solves again with them, until they no longer change.
  /// \param keep_unmeasured whether chains without redundant measurements keep their factors
  /// \returns false if the covariances for the estimate do not exist, or the optimisation was stopped
  bool refine(bool keep_unmeasured) {
    for (int round = 0; round < kScaleRounds; ++round) {
      std::optional<OdometryVariances> variances = estimated_odometry_variances(
          given_.graph, chains_, problem_.isometries(best_->poses), best_->result.weights,
          best_->odometry_variances, largest_variance(), keep_unmeasured, given_.options);
      if (!variances) return false;
      if (!differ(*variances, best_->odometry_variances)) break;
      if (!solve_with(std::move(*variances))) return false;
    }
    return true;
  }

  /// Continues the best solution with these variance factors and replaces it by the result.
  /// \returns false if the optimisation was stopped: the best solution then stays
  bool solve_with(OdometryVariances variances) {
    Scaled scaled(*this, variances);
    PoseProblem& problem = scaled.problem();
    Solution out;
    out.poses = best_->poses;
    out.odometry_variances = std::move(variances);
    std::vector<char> kept(problem.edges());
    for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = best_->result.weights[k] > kKept ? 1 : 0;
    RobustSolver(scaled.given(), gross_, problem, equations_, out.poses).solve_from(kept, {}, out.result);
    out.result.start = best_->result.start;
    if (out.result.optimization.termination == Termination::kStopped) {
      count_discarded(out.result);
      return false;
    }
    forget();
    keep_better(std::move(out));
    return true;
  }

  [[nodiscard]] bool has_solution() const { return best_.has_value(); }
  [[nodiscard]] bool excludes_closures() const { return best_->result.outliers > 0; }
  /// Whether the best solution excludes closures that the stated odometry rules out.
  [[nodiscard]] bool excludes_gross_outliers() const {
    for (std::size_t k = 0; k < gross_.excluded.size(); ++k) {
      if (gross_.excluded[k] != 0 && best_->result.weights[k] <= kKept) return true;
    }
    return false;
  }
  /// Number of confirmed closures that the best solution excludes.
  [[nodiscard]] std::size_t left_out_confirmed() const {
    PoseProblem problem = problem_;
    std::copy(best_->result.weights.begin(), best_->result.weights.end(), problem.weight.begin());
    return left_out_confirmed(problem);
  }
  /// Discards the best solution; its iterations still count.
  void forget() {
    if (best_) count_discarded(best_->result);
    best_.reset();
  }
  /// Writes the odometry scales and weights to the best result.
  void report_odometry() {
    GncResult& result = best_->result;
    OdometryVariances& variances = best_->odometry_variances;
    for (auto entry = variances.begin(); entry != variances.end();) {
      // A chain that was joined to another chain uses that chain's factor.
      entry = chains_[entry->first] == entry->first ? std::next(entry) : variances.erase(entry);
    }
    for (const auto& [chain, variance] : variances) {
      result.odometry_scales.push_back({given_.graph.nodes()[chain].key, std::sqrt(variance)});
    }
    for (std::size_t k = 0; k < result.weights.size(); ++k) {
      if (given_.graph.edges()[k].kind != EdgeKind::kOdometry) continue;
      const auto found = variances.find(chains_[given_.graph.ends(k).from]);
      if (found != variances.end()) result.weights[k] = 1.0 / found->second;
    }
  }

  /// The best solution, with the iterations of all starts.
  [[nodiscard]] Solution best() && {
    GncResult& result = best_->result;
    result.outer_iterations += discarded_counts_.outer_iterations;
    result.optimization.iterations += discarded_counts_.optimization.iterations;
    result.optimization.factorizations += discarded_counts_.optimization.factorizations;
    return std::move(*best_);
  }

 private:
  [[nodiscard]] double largest_variance() const {
    return given_.gnc.odometry_margin * given_.gnc.odometry_margin;
  }
  /// Limits variance factors to the options' odometry_margin.
  [[nodiscard]] OdometryVariances allowed(OdometryVariances variances) const {
    if (!given_.gnc.second_start || given_.gnc.odometry_margin <= 1.0) return {};
    for (auto& [chain, variance] : variances) variance = std::min(variance, largest_variance());
    return variances;
  }

  /// The problem with more uncertain odometry.
  class Scaled {
   public:
    Scaled(const Starts& starts, const OdometryVariances& variances) {
      const RobustProblem& stated = starts.given_;
      if (!variances.empty()) {
        graph_.emplace(with_odometry_variances(stated.graph, starts.chains_, variances));
        forest_.emplace(*graph_);
      }
      given_.emplace(RobustProblem{graph_ ? *graph_ : stated.graph, forest_ ? *forest_ : stated.forest,
                                   stated.start, stated.options, stated.gnc, stated.pool, stated.stop});
      problem_.emplace(graph_ ? PoseProblem(*graph_) : starts.problem_);
    }
    Scaled(const Scaled&) = delete;
    Scaled& operator=(const Scaled&) = delete;

    [[nodiscard]] const RobustProblem& given() const { return *given_; }
    [[nodiscard]] PoseProblem& problem() { return *problem_; }

   private:
    std::optional<PoseGraph> graph_;
    std::optional<OdometryForest> forest_;
    std::optional<RobustProblem> given_;
    std::optional<PoseProblem> problem_;
  };

  Solution solved_from(const GrossOutliers& gross, std::vector<Pose> poses, GncStart start) {
    PoseProblem problem = problem_;
    Solution out;
    out.poses = std::move(poses);
    RobustSolver(given_, gross, problem, equations_, out.poses).solve(out.result);
    out.result.start = start;
    return out;
  }

  [[nodiscard]] std::vector<char> confirmed_of(const std::vector<char>& wanted) const {
    const double c2 = chi_squared_quantile(given_.gnc.inlier_probability, given_.graph.degrees_of_freedom());
    return confirmed_closures(given_.graph, given_.forest, wanted, gross_.scale * c2);
  }

  /// Number of confirmed closures with weights near 0. They may be true, with odometry worse than stated, or
  /// a consistent group of false closures.
  [[nodiscard]] std::size_t left_out_confirmed(const PoseProblem& problem) const {
    std::vector<char> left_out(problem.edges());
    for (std::size_t k = 0; k < left_out.size(); ++k) left_out[k] = problem.weight[k] <= kKept ? 1 : 0;
    const std::vector<char> confirmed = confirmed_of(left_out);
    return static_cast<std::size_t>(std::count(confirmed.begin(), confirmed.end(), 1));
  }

  /// The chordal estimate of known inliers and chosen closures (by edge).
  Solution chordal_of(PoseProblem& problem, const std::vector<char>& chosen) const {
    for (std::size_t k = 0; k < problem.edges(); ++k) {
      problem.weight[k] = known_inlier(given_.graph.edges()[k]) || chosen[k] != 0 ? 1.0 : 0.0;
    }
    Solution out;
    int& factorizations = out.result.optimization.factorizations;
    out.poses =
        first_estimate(Initialization::kChordal, given_.graph, problem, given_.options, factorizations);
    return out;
  }

  /// Keeps the solution of the lower truncated cost. The iterations of the other one still count.
  void keep_better(Solution&& other) {
    other.freedom = equations_.freedom();
    const bool stopped = other.result.optimization.termination == Termination::kStopped;
    if (!best_ || other.result.truncated_cost < (1.0 - kEqual) * best_->result.truncated_cost) {
      forget();
      best_ = std::move(other);
    } else {
      count_discarded(other.result);
    }
    if (stopped) set_termination(Termination::kStopped, best_->result.optimization);
  }

  void count_discarded(const GncResult& discarded) {
    discarded_counts_.outer_iterations += discarded.outer_iterations;
    discarded_counts_.optimization.iterations += discarded.optimization.iterations;
    discarded_counts_.optimization.factorizations += discarded.optimization.factorizations;
  }

  const RobustProblem& given_;
  const PoseProblem& problem_;
  NormalEquations& equations_;
  const std::vector<std::uint32_t> chains_;  // of odometry, by node
  const std::vector<double> d2_;             // innovations, by edge
  const GrossOutliers gross_;
  std::optional<Solution> best_;
  GncResult discarded_counts_;  // counts of solutions that are not the best
};

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
  if (several && starts.from_confirmed()) return;
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
  const OdometryForest forest(graph);
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
