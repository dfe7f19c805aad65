// SPDX-License-Identifier: BSD-3-Clause
#include "robust_starts.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "confirmed_closures.hpp"
#include "initialization.hpp"
#include "innovation.hpp"
#include "scaled_odometry.hpp"

namespace loopwise::detail {
namespace {

/// Below this measured variance of the noise, relative to the stated one, a start takes the measured one,
/// with a margin. That start counts only if it leaves no doubt, so that the margin may be small.
constexpr double kFarTooPessimistic = 0.02;
constexpr double kMeasuredMargin = 2.0;

/// Bound on rounds that estimate odometry's uncertainty and solve with it. Each round admits more closures,
/// which give a better estimate.
constexpr int kScaleRounds = 4;

}  // namespace

Starts::Starts(const RobustProblem& given, const PoseProblem& problem, NormalEquations& equations)
    : given_(given),
      problem_(problem),
      equations_(equations),
      chains_(odometry_chains(given.graph)),
      d2_(innovations(given.graph, given.forest)),
      gross_(find_gross_outliers(given.graph, d2_, given.gnc.innovation_probability)) {
  if (gross_.scale >= 1.0) return;
  const double c2 = chi_squared_quantile(given.gnc.inlier_probability, given.graph.degrees_of_freedom());
  least_scale_ = measure_noise(given.graph, given.forest, c2, gross_);
  if (least_scale_ > gross_.scale) {
    const double measured = gross_.measured;
    gross_ = gross_outliers_of(d2_, 1.0);
    gross_.measured = measured;
  }
}

bool Starts::from_last(const WarmStart& warm) {
  // The thresholds of the stated noise would admit false closures that the measured noise excludes.
  if (given_.gnc.second_start && gross_.measured < kFarTooPessimistic && !has_heavy_tail()) return false;
  const OdometryVariances variances = allowed(warm.odometry_variances);
  Scaled scaled(*this, variances);
  PoseProblem& problem = scaled.problem();
  Solution out;
  out.poses = warm.poses;
  out.odometry_variances = variances;
  RobustSolver solver(scaled.given(), gross_, problem, equations_, out.poses);
  solver.minimize_with(solver.plausible(warm.known, warm.kept));
  solver.truncate(true);
  std::vector<char> may_return(warm.known.size());
  for (std::size_t k = 0; k < may_return.size(); ++k) may_return[k] = warm.known[k] != 0 ? 0 : 1;
  solver.grow(may_return);
  // A closure that was kept and no longer fits is excluded for a reason, or returns.
  for (std::size_t k = 0; k < may_return.size(); ++k) may_return[k] |= warm.kept[k];
  const bool explained = solver.admit_unexplained(may_return);
  solver.settle();
  finish(solver, GncStart::kLastResult, out);
  // Some right closures are beyond the threshold by chance, the more the larger the graph is.
  const double by_chance = (1.0 - given_.gnc.inlier_probability) * static_cast<double>(out.result.inliers);
  std::size_t lost = 0;
  for (std::size_t k = 0; k < warm.kept.size(); ++k) {
    lost += warm.kept[k] != 0 && problem.weight[k] <= kKept ? 1 : 0;
  }
  bool in_doubt = !out.result.optimization.converged || !explained || static_cast<double>(lost) > by_chance;
  if (!in_doubt) {
    const double before = static_cast<double>(warm.left_out_confirmed);
    const std::size_t now = count(confirmed_left_out(given_, out.result.weights));
    in_doubt = static_cast<double>(now) > (1.0 + given_.gnc.warm_growth) * before + by_chance;
  }
  keep_better(std::move(out));
  return !in_doubt;
}

bool Starts::from_measured_noise() {
  // Noise with a heavy tail has no single variance.
  if (gross_.measured >= kFarTooPessimistic || least_scale_ > 0.0) return false;
  PoseGraph graph = given_.graph;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    graph.set_information(k, graph.edges()[k].information / (kMeasuredMargin * gross_.measured));
  }
  const OdometryForest forest =
      joined_forest(graph, chi_squared_quantile(given_.gnc.inlier_probability, graph.degrees_of_freedom()));
  const PoseProblem problem(graph);
  const RobustProblem given{graph,      forest,      given_.start, given_.options,
                            given_.gnc, given_.pool, given_.stop};
  Starts measured(given, problem, equations_);
  // By the measured noise, the stated one is right. If it is not, copies of the odometry count as closures
  // now, and would exclude all others.
  if (measured.gross_.scale < 1.0) return false;
  std::optional<FromConfirmed> found =
      measured.solve_from_confirmed({}, measured.gross_, true, Groups::kFirst);
  if (!found) return false;
  count_discarded(found->solution.result);
  if (!found->beyond_doubt || given_.stop.stop_requested()) return false;
  // The same closures with the stated information, which counts beside priors and other factors.
  PoseProblem stated = problem_;
  Solution out;
  out.poses = std::move(found->solution.poses);
  RobustSolver solver(given_, gross_, stated, equations_, out.poses);
  solver.minimize_with(kept_by(found->solution.result.weights));
  finish(solver, GncStart::kConfirmed, out);
  out.result.noise_scale = std::sqrt(gross_.measured);
  keep_better(std::move(out));
  return true;
}

void Starts::from_first_estimate() {
  if (std::exchange(first_estimate_tried_, true)) return;
  PoseProblem problem = problem_;
  Solution out;
  out.poses = given_.start;
  RobustSolver solver(given_, gross_, problem, equations_, out.poses);
  solver.solve();
  finish(solver, GncStart::kFirstEstimate, out);
  keep_better(std::move(out));
}

bool Starts::from_chordal() {
  if (std::exchange(chordal_tried_, true)) return false;
  std::vector<char> chosen(gross_.excluded.size());
  for (std::size_t k = 0; k < chosen.size(); ++k) chosen[k] = gross_.excluded[k] != 0 ? 0 : 1;
  PoseProblem problem = problem_;
  Solution out = chordal_of(problem, chosen);
  RobustSolver solver(given_, gross_, problem, equations_, out.poses);
  solver.solve();
  const bool explained = has_heavy_tail() && solver.unexplained(chosen).empty();
  finish(solver, GncStart::kChordal, out);
  bool beyond_doubt = explained && out.result.optimization.converged;
  if (beyond_doubt) {
    const double by_chance = (1.0 - given_.gnc.inlier_probability) * static_cast<double>(out.result.inliers);
    beyond_doubt = static_cast<double>(count(confirmed_left_out(given_, out.result.weights))) <= by_chance &&
                   (!best_ || out.cost <= (1.0 + kEqual) * best_->cost);
  }
  keep_better(std::move(out));
  return beyond_doubt;
}

void Starts::rescale_odometry() {
  if (best_->result.outliers == 0) {
    refine(true);
    return;
  }
  Solution stated = *best_;
  if (!refine(true) || given_.stop.stop_requested()) return;
  Solution from_stated = std::move(*best_);
  best_ = std::move(stated);
  // As a standard deviation this is the geometric mean of the stated value and the largest allowed one.
  const bool finished = solve_with(all_chains_with(given_.gnc.odometry_margin)) && refine(true);
  if (finished && from_stated.result.inliers < best_->result.inliers) {
    count_discarded(from_stated.result);
  } else {
    count_discarded(best_->result);
    best_ = std::move(from_stated);
  }
}

void Starts::from_doubted_odometry() {
  const OdometryVariances variances = best_->odometry_variances;
  Scaled scaled(*this, variances);
  const GrossOutliers fewer =
      variances.empty() ? gross_outliers_of(d2_, given_.gnc.odometry_margin)
                        : gross_outliers_of(innovations(scaled.given().graph, scaled.given().forest), 1.0);
  if (fewer.excluded == gross_.excluded) return;
  Solution out;
  out.poses = given_.start;
  out.odometry_variances = variances;
  RobustSolver solver(scaled.given(), fewer, scaled.problem(), equations_, out.poses);
  solver.solve();
  finish(solver, GncStart::kDoubtedOdometry, out);
  if (gives_up_closures(best_->result, out.result)) return count_discarded(out.result);
  keep_better(std::move(out));
  if (best_->result.start == GncStart::kDoubtedOdometry) refine(true);
}

bool Starts::refine(bool keep_unmeasured) {
  for (int round = 0; round < kScaleRounds; ++round) {
    std::optional<OdometryEstimate> estimate = estimated_variances(*best_, keep_unmeasured);
    if (!estimate) return false;
    if (!differ(estimate->variances, best_->odometry_variances)) break;
    if (!solve_with(std::move(estimate->variances))) return false;
  }
  return true;
}

/// The variance factors at a solution; nothing if its covariances do not exist.
std::optional<OdometryEstimate> Starts::estimated_variances(const Solution& at, bool keep_unmeasured) const {
  return estimated_odometry_variances(given_.graph, chains_, problem_.isometries(at.poses), at.result.weights,
                                      at.odometry_variances, largest_variance(), keep_unmeasured,
                                      given_.options);
}

/// Continues the best solution with these variance factors and replaces it by the result.
/// \returns false if the optimisation was stopped: the best solution then stays
bool Starts::solve_with(OdometryVariances variances) {
  Scaled scaled(*this, variances);
  Solution out;
  out.poses = best_->poses;
  out.odometry_variances = std::move(variances);
  RobustSolver solver(scaled.given(), gross_, scaled.problem(), equations_, out.poses);
  solver.minimize_with(kept_by(best_->result.weights));
  solver.truncate(true);
  solver.grow({});
  solver.settle();
  finish(solver, best_->result.start, out);
  if (out.result.optimization.termination == Termination::kStopped) {
    count_discarded(out.result);
    return false;
  }
  forget();
  keep_better(std::move(out));
  return true;
}

bool Starts::excludes_gross_outliers() const {
  for (std::size_t k = 0; k < gross_.excluded.size(); ++k) {
    if (gross_.excluded[k] != 0 && best_->result.weights[k] <= kKept) return true;
  }
  return false;
}

std::size_t Starts::left_out_confirmed() const {
  return count(confirmed_left_out(given_, best_->result.weights));
}

void Starts::forget() {
  if (best_) count_discarded(best_->result);
  best_.reset();
}

void Starts::report_odometry() {
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

Solution Starts::best() && {
  GncResult& result = best_->result;
  result.outer_iterations += discarded_counts_.outer_iterations;
  result.optimization.iterations += discarded_counts_.optimization.iterations;
  result.optimization.factorizations += discarded_counts_.optimization.factorizations;
  return std::move(*best_);
}

/// Limits variance factors to the options' odometry_margin.
OdometryVariances Starts::allowed(OdometryVariances variances) const {
  if (!given_.gnc.second_start || given_.gnc.odometry_margin <= 1.0) return {};
  for (auto& [chain, variance] : variances) variance = std::min(variance, largest_variance());
  return variances;
}

OdometryVariances Starts::all_chains_with(double variance) const {
  OdometryVariances out;
  for (std::size_t k = 0; k < problem_.edges(); ++k) {
    if (given_.graph.edges()[k].kind == EdgeKind::kOdometry)
      out[chains_[given_.graph.ends(k).from]] = variance;
  }
  return out;
}

GrossOutliers Starts::gross_outliers_of(const std::vector<double>& d2, double odometry_margin) const {
  GrossOutliers out =
      find_gross_outliers(given_.graph, d2, given_.gnc.innovation_probability, odometry_margin, least_scale_);
  out.noise = gross_.noise;
  return out;
}

std::vector<char> Starts::confirmed_of(const RobustProblem& given, const std::vector<char>& wanted,
                                       double scale) const {
  const double c2 = chi_squared_quantile(given.gnc.inlier_probability, given.graph.degrees_of_freedom());
  return confirmed_closures(given.graph, given.forest, wanted, scale * c2);
}

/// Confirmed closures with weights near 0. They may be true, with odometry worse than stated, or a consistent
/// group of false closures.
std::vector<char> Starts::confirmed_left_out(const RobustProblem& given,
                                             const std::vector<double>& weights) const {
  std::vector<char> left_out(problem_.edges());
  for (std::size_t k = 0; k < left_out.size(); ++k) left_out[k] = weights[k] <= kKept ? 1 : 0;
  return confirmed_of(given, left_out, gross_.scale);
}

/// The chordal estimate of known inliers and chosen closures (by edge).
Solution Starts::chordal_of(PoseProblem& problem, const std::vector<char>& chosen) const {
  for (std::size_t k = 0; k < problem.edges(); ++k) {
    problem.weight[k] = known_inlier(given_.graph.edges()[k]) || chosen[k] != 0 ? 1.0 : 0.0;
  }
  Solution out;
  int& factorizations = out.result.optimization.factorizations;
  out.poses = first_estimate(Initialization::kChordal, given_.graph, problem, given_.options, factorizations);
  return out;
}

/// Writes the solver's result, cost and components to the solution.
void Starts::finish(RobustSolver& solver, GncStart start, Solution& out) {
  solver.report(out.result);
  out.result.start = start;
  out.cost = solver.truncated_cost();
  out.freedom = equations_.freedom();
}

/// The cost of a solution with the uncertainty of odometry that it takes, by restricted maximum likelihood.
double Starts::judged_cost(const Solution& solution) const {
  double log_determinant = 0.0;
  if (!solution.odometry_variances.empty()) {
    const std::optional<OdometryEstimate> estimate = estimated_variances(solution, true);
    if (estimate) log_determinant = estimate->log_determinant;
  }
  return solution.cost + 0.5 * gross_.noise * log_determinant;
}

/// A copy whose iterations do not count, because those of the original do.
Solution Starts::without_counts(Solution copy) {
  copy.result.outer_iterations = 0;
  copy.result.optimization.iterations = 0;
  copy.result.optimization.factorizations = 0;
  return copy;
}

/// A solution after refine(). The best one stays as it is.
Solution Starts::refined(Solution solution) {
  std::optional<Solution> best = std::exchange(best_, std::move(solution));
  refine(true);
  solution = std::move(*best_);
  best_ = std::move(best);
  return solution;
}

/// Whether another result loses more than this share of the closures that one keeps.
bool Starts::gives_up_closures(const GncResult& one, const GncResult& other, double share) const {
  std::size_t kept = 0, lost = 0;
  for (std::size_t k = 0; k < problem_.edges(); ++k) {
    if (known_inlier(given_.graph.edges()[k]) || one.weights[k] <= kKept) continue;
    ++kept;
    lost += other.weights[k] <= kKept ? 1 : 0;
  }
  return static_cast<double>(lost) > share * static_cast<double>(kept);
}

/// Keeps the solution of the lower truncated cost. The iterations of the other one still count.
void Starts::keep_better(Solution&& other) {
  const bool stopped = other.result.optimization.termination == Termination::kStopped;
  if (!best_ || other.cost < (1.0 - kEqual) * best_->cost) {
    forget();
    best_ = std::move(other);
  } else {
    count_discarded(other.result);
  }
  if (stopped) set_termination(Termination::kStopped, best_->result.optimization);
}

void Starts::count_discarded(const GncResult& discarded) {
  discarded_counts_.outer_iterations += discarded.outer_iterations;
  discarded_counts_.optimization.iterations += discarded.optimization.iterations;
  discarded_counts_.optimization.factorizations += discarded.optimization.factorizations;
}

}  // namespace loopwise::detail
