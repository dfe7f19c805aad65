// SPDX-License-Identifier: BSD-3-Clause
#include "robust_starts.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "confirmed_closures.hpp"
#include "initialization.hpp"
#include "innovation.hpp"

namespace loopwise::detail {
namespace {

/// Costs that differ by less than this share are equal; the result of the earlier start is then kept.
constexpr double kEqual = 1e-9;

/// The confirmed closures start a solution of their own if they are at least kFewestConfirmed of the closures
/// that odometry does not rule out. It is graduated if the minimum with all of them loses more than
/// kMostConfirmedLost. The other starts follow if it loses more than kMostContradicting.
constexpr double kFewestConfirmed = 1.0 / 3.0;
/// If they contradict each other, those in large groups start alone, if they are at least
/// kFewestInLargeGroups of the closures. False groups may be joined to them by chance, so up to
/// kMostOfGroupsLost may be excluded.
constexpr double kFewestInLargeGroups = 0.1;
constexpr double kMostOfGroupsLost = 0.1;
constexpr double kMostConfirmedLost = 0.01;
constexpr double kMostContradicting = 0.5;
/// Bounds on steps to the minimum with all confirmed closures, and on rounds of truncated least squares from
/// there. If they agree, half of these are enough.
constexpr int kMostSteps = 15;
constexpr int kMostRounds = 6;
/// If the noise is far below the stated one, the innovation test has a margin. Closures within it may be
/// false; they do not start a solution, but may join it.
constexpr double kShareOfMargin = 0.16;
/// Below this measured variance of the noise, relative to the stated one, a start takes the measured one,
/// with a margin. That start counts only if it leaves no doubt, so that the margin may be small.
constexpr double kFarTooPessimistic = 0.02;
constexpr double kMeasuredMargin = 2.0;
/// A start with closures that the stated odometry rules out may lose this share of the closures kept without
/// them. Closures that agree with each other but not with the others, as from two floors of one plan, would
/// replace more.
constexpr double kMostGivenUp = 0.03;

/// Bound on rounds that estimate odometry's uncertainty and solve with it. Each round admits more closures,
/// which give a better estimate.
constexpr int kScaleRounds = 4;
/// Bound on starts from the confirmed closures, each with a new estimate of odometry's uncertainty.
constexpr int kConfirmedRounds = 6;
/// Margin on the variance factors that a solution with excluded closures shows.
constexpr double kShownMargin = 4.0;
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

/// Variance of the noise, relative to the stated one, by which closures that start a solution agree.
double scale_of_seeds(const GrossOutliers& gross) {
  return gross.scale >= 1.0 ? gross.scale : kShareOfMargin * gross.scale;
}

std::size_t count(const std::vector<char>& flags) {
  return static_cast<std::size_t>(std::count(flags.begin(), flags.end(), 1));
}

std::vector<char> kept_by(const std::vector<double>& weights) {
  std::vector<char> kept(weights.size());
  for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = weights[k] > kKept ? 1 : 0;
  return kept;
}

}  // namespace

/// The problem with more uncertain odometry.
class Starts::Scaled {
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

Starts::Starts(const RobustProblem& given, const PoseProblem& problem, NormalEquations& equations)
    : given_(given),
      problem_(problem),
      equations_(equations),
      chains_(odometry_chains(given.graph)),
      d2_(innovations(given.graph, given.forest)),
      gross_(find_gross_outliers(given.graph, d2_, given.gnc.innovation_probability)) {
  if (gross_.scale < 1.0) measure_noise(given.graph, given.forest, gross_);
}

bool Starts::from_last(const WarmStart& warm) {
  // The thresholds of the stated noise would admit false closures that the measured noise excludes.
  if (given_.gnc.second_start && gross_.measured < kFarTooPessimistic) return false;
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
  solver.minimize_with(chosen);
  solver.truncate(true);
  solver.grow(is_new);
  finish(solver, GncStart::kLastResult, out);
  bool in_doubt = !out.result.optimization.converged;
  for (std::size_t k = 0; k < warm.kept.size(); ++k) {
    in_doubt = in_doubt || (warm.kept[k] != 0 && problem.weight[k] <= kKept);
  }
  in_doubt = in_doubt || !solver.unexplained(is_new).empty();
  if (!in_doubt) {
    const double before = static_cast<double>(warm.left_out_confirmed);
    const std::size_t now = count(confirmed_left_out(given_, out.result.weights));
    in_doubt = static_cast<double>(now) > (1.0 + given_.gnc.warm_growth) * before;
  }
  keep_better(std::move(out));
  return !in_doubt;
}

bool Starts::from_measured_noise() {
  if (gross_.measured >= kFarTooPessimistic) return false;
  PoseGraph graph = given_.graph;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    graph.set_information(k, graph.edges()[k].information / (kMeasuredMargin * gross_.measured));
  }
  const OdometryForest forest(graph);
  const PoseProblem problem(graph);
  const RobustProblem given{graph,      forest,      given_.start, given_.options,
                            given_.gnc, given_.pool, given_.stop};
  Starts measured(given, problem, equations_);
  // By the measured noise, the stated one is right. If it is not, copies of the odometry count as closures
  // now, and would exclude all others.
  if (measured.gross_.scale < 1.0) return false;
  std::optional<FromConfirmed> found = measured.solve_from_confirmed({}, measured.gross_, true);
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

bool Starts::from_confirmed() {
  std::optional<FromConfirmed> found = solve_from_confirmed({}, gross_, true);
  if (!found) return false;
  std::optional<Solution> other;
  if (given_.gnc.odometry_margin > 1.0 && !found->plain) {
    const std::optional<OdometryEstimate> estimate = estimated_variances(found->solution, true);
    if (!estimate) {
      found->beyond_doubt = false;
    } else if (!estimate->variances.empty()) {
      found->beyond_doubt = false;
      other = with_doubted_odometry(*found, estimate->variances);
    } else if (!found->beyond_doubt && found->explained) {
      other = with_doubted_test(*found);
    }
  }
  if (other) {
    count_discarded(found->solution.result);
    keep_better(std::move(*other));
    refine(false);
    return true;
  }
  const bool beyond_doubt = found->beyond_doubt;
  if (found->settled) {
    keep_better(std::move(found->solution));
  } else {
    count_discarded(found->solution.result);
  }
  return beyond_doubt;
}

/// A start from the confirmed closures among those that odometry allows.
class Starts::ConfirmedStart {
 public:
  /// All arguments must outlive the object.
  ConfirmedStart(Starts& starts, const OdometryVariances& variances, const GrossOutliers& gross)
      : starts_(starts), gross_(gross), scaled_(starts, variances), allowed_(gross.excluded.size()) {
    for (std::size_t k = 0; k < allowed_.size(); ++k) {
      allowed_[k] = known_inlier(given().graph.edges()[k]) || gross.excluded[k] != 0 ? 0 : 1;
    }
    choose(starts.seeds_among(given(), allowed_, gross));
    out_.solution.odometry_variances = variances;
  }

  [[nodiscard]] bool are_few() const {
    return seeds_ == 0.0 || seeds_ < kFewestConfirmed * static_cast<double>(count(allowed_));
  }

  FromConfirmed solve(bool grow) {
    out_.solution.poses = chordal();
    const std::vector<Pose> start = out_.solution.poses;
    solver_.emplace(given(), gross_, problem(), starts_.equations_, out_.solution.poses);
    bool agree = agree_at_minimum();
    bool doubtful = (!grow || !agree) && is_in_doubt(gross_.excluded, seeds_);
    // With doubted odometry, a large group that agrees may be the error of a slip that bends the path.
    if (!agree && grow && agree_in_large_groups()) {
      agree = true;
      doubtful = false;
    }
    out_.plain = agree;
    if (!agree && !doubtful) {
      out_.solution.poses = start;
      agree = agree_after_graduation();
      doubtful = !agree || lost() > kMostContradicting * seeds_;
    }
    if (!doubtful) explain_the_others(grow);
    out_.settled = agree;
    starts_.finish(*solver_, GncStart::kConfirmed, out_.solution);
    out_.solution.result.optimization.factorizations += factorizations_;
    return std::move(out_);
  }

 private:
  [[nodiscard]] const RobustProblem& given() const { return scaled_.given(); }
  [[nodiscard]] PoseProblem& problem() { return scaled_.problem(); }

  void choose(std::vector<char> confirmed) {
    confirmed_ = std::move(confirmed);
    seeds_ = static_cast<double>(count(confirmed_));
  }

  std::vector<Pose> chordal() {
    Solution first = starts_.chordal_of(problem(), confirmed_);
    factorizations_ += first.result.optimization.factorizations;
    return std::move(first.poses);
  }

  /// Number of the confirmed closures that the solution excludes.
  [[nodiscard]] double lost() {
    double number = 0.0;
    for (std::size_t k = 0; k < confirmed_.size(); ++k) {
      number += confirmed_[k] != 0 && problem().weight[k] <= kKept ? 1.0 : 0.0;
    }
    return number;
  }

  [[nodiscard]] bool is_in_doubt(const std::vector<char>& among, double allowance) {
    return static_cast<double>(starts_.in_doubt(given(), problem(), out_.solution.poses, among)) >
           std::min(allowance, kMostConfirmedLost * seeds_);
  }

  bool agree_at_minimum() {
    const auto few = [&](double number) { return number <= kMostConfirmedLost * seeds_; };
    return few(static_cast<double>(solver_->minimize_with(confirmed_, kMostSteps))) &&
           solver_->truncate(true, kMostRounds) && few(lost());
  }

  bool agree_after_graduation() {
    solver_->graduate_with(confirmed_);
    return solver_->truncate(false, kMostRounds);
  }

  /// Tries the closures in large groups in place of all confirmed ones. If they do not agree either, the
  /// state before is restored.
  bool agree_in_large_groups() {
    if (given().stop.stop_requested()) return false;
    std::vector<char> large = starts_.in_large_groups_of(given(), confirmed_, gross_);
    if (large == confirmed_ ||
        static_cast<double>(count(large)) < kFewestInLargeGroups * static_cast<double>(count(allowed_)))
      return false;
    const std::vector<char> confirmed = confirmed_, kept = kept_by(problem().weight);
    const std::vector<Pose> poses = out_.solution.poses;
    choose(std::move(large));
    out_.solution.poses = chordal();
    if (agree_at_minimum() || (agree_after_graduation() && lost() <= kMostOfGroupsLost * seeds_)) return true;
    choose(confirmed);
    out_.solution.poses = poses;
    solver_->keep(kept);
    return false;
  }

  void explain_the_others(bool grow) {
    if (grow) solver_->grow({});
    const std::vector<char> all(confirmed_.size(), 1);
    out_.plain = out_.plain && solver_->unexplained(allowed_).empty() &&
                 static_cast<double>(count(starts_.confirmed_left_out(given(), problem().weight))) <= lost();
    out_.explained = solver_->admit_unexplained(allowed_);
    out_.beyond_doubt = out_.explained && !is_in_doubt(all, lost());
  }

  Starts& starts_;
  const GrossOutliers& gross_;
  Scaled scaled_;
  std::vector<char> allowed_, confirmed_;  // by edge
  double seeds_ = 0.0;                     // number of the confirmed ones
  int factorizations_ = 0;                 // of chordal estimates
  FromConfirmed out_;
  std::optional<RobustSolver> solver_;
};

/// With these odometry variances, from the closures that others confirm among those that odometry then
/// allows. Nothing if they are few. If they contradict each other, those in large groups start alone; if
/// these do too, the solution is graduated among all of them, unless it is in doubt anyway because of those
/// that odometry rules out. \param grow whether to re-admit closures as well
std::optional<Starts::FromConfirmed> Starts::solve_from_confirmed(const OdometryVariances& variances,
                                                                  const GrossOutliers& gross, bool grow) {
  ConfirmedStart start(*this, variances, gross);
  if (start.are_few()) return std::nullopt;
  return start.solve(grow);
}

/// Those among confirmed closures that belong to large groups of closures that confirm each other.
std::vector<char> Starts::in_large_groups_of(const RobustProblem& given, const std::vector<char>& confirmed,
                                             const GrossOutliers& gross) const {
  const double c2 = chi_squared_quantile(given.gnc.inlier_probability, given.graph.degrees_of_freedom());
  return in_large_groups(given.graph, given.forest, confirmed, scale_of_seeds(gross) * c2);
}

/// Number of confirmed closures among some (by edge) that a solution excludes although it would not
/// contradict them if odometry were as uncertain as the options allow. Right closures far from the kept ones
/// are such; a group of false closures among kept ones is contradicted in any case.
std::size_t Starts::in_doubt(const RobustProblem& given, const PoseProblem& problem,
                             const std::vector<Pose>& poses, const std::vector<char>& among) {
  std::vector<char> left_out = confirmed_left_out(given, problem.weight);
  for (std::size_t k = 0; k < left_out.size(); ++k) left_out[k] = among[k] != 0 ? left_out[k] : 0;
  if (count(left_out) == 0) return 0;
  // Pessimistic information says nothing of odometry that is too sure of itself.
  Scaled widest(*this, gross_.noise < 1.0 ? OdometryVariances() : all_chains_with(largest_variance()));
  std::vector<Pose> here = poses;
  RobustSolver solver(widest.given(), gross_, widest.problem(), equations_, here);
  solver.keep(kept_by(problem.weight));
  return solver.unexplained(left_out).size();
}

/// For a start from the confirmed closures whose solution shows odometry to be worse than stated. Excluded
/// closures make odometry look better than it is, so two attempts begin with more uncertainty than `shown`:
/// the largest for all chains, and a margin for the chains that are shown to be worse. The first finds right
/// closures that would contradict each other otherwise; but false closures bend odometry, which then seems
/// as bad as they need it. \returns the solution of the lower restricted cost among those that are beyond
/// doubt and cost less than the stated odometry
std::optional<Solution> Starts::with_doubted_odometry(const FromConfirmed& stated,
                                                      const OdometryVariances& shown) {
  std::vector<OdometryVariances> attempts{all_chains_with(largest_variance())};
  if (stated.settled) {  // otherwise `shown` is not that of a minimum
    OdometryVariances margin = shown;
    for (auto& [chain, variance] : margin) variance = std::min(kShownMargin * variance, largest_variance());
    if (differ(margin, attempts.front())) attempts.push_back(std::move(margin));
  }
  std::optional<Doubted> best;
  for (const OdometryVariances& first : attempts) {
    std::optional<Doubted> found = settled_odometry(first);
    if (!found) continue;
    const bool worse = stated.settled && (gives_up_closures(stated.solution.result, found->solution.result) ||
                                          found->restricted_cost > stated.solution.cost);
    if (worse || (best && best->restricted_cost <= found->restricted_cost)) {
      count_discarded(found->solution.result);
      continue;
    }
    if (best) count_discarded(best->solution.result);
    best = std::move(found);
  }
  if (!best) return std::nullopt;
  return std::move(best->solution);
}

/// Alternates between a start from the closures that are confirmed with odometry of some uncertainty, and the
/// estimate of the uncertainty at its solution, until this no longer changes. \returns the solution if it is
/// then beyond doubt
std::optional<Starts::Doubted> Starts::settled_odometry(OdometryVariances used) {
  for (int round = 0; round < kConfirmedRounds && !given_.stop.stop_requested(); ++round) {
    const Scaled scaled(*this, used);
    std::optional<FromConfirmed> found = solve_from_confirmed(
        used, gross_outliers_of(innovations(scaled.given().graph, scaled.given().forest), 1.0), false);
    if (!found) return std::nullopt;
    std::optional<OdometryEstimate> estimate = estimated_variances(found->solution, true);
    const bool is_worse = estimate && !estimate->variances.empty();
    if (is_worse && !differ(estimate->variances, used) && found->beyond_doubt) {
      const double restricted_cost = found->solution.cost + 0.5 * gross_.noise * estimate->log_determinant;
      return Doubted{std::move(found->solution), restricted_cost};
    }
    count_discarded(found->solution.result);
    if (!is_worse || !differ(estimate->variances, used)) return std::nullopt;
    used = std::move(estimate->variances);
  }
  return std::nullopt;
}

/// For a start from the confirmed closures that is in doubt, although its closures do not show odometry to be
/// worse than stated: odometry may have slipped once. Starts from the closures that are confirmed and that
/// odometry of the largest uncertainty allows, and drops the doubt if this solution costs more. \returns the
/// solution if it costs less and is beyond doubt itself
std::optional<Solution> Starts::with_doubted_test(FromConfirmed& stated) {
  std::optional<FromConfirmed> rival =
      solve_from_confirmed({}, gross_outliers_of(d2_, given_.gnc.odometry_margin), true);
  if (!rival) return std::nullopt;
  if (rival->settled) {
    const bool better = rival->solution.cost < (1.0 - kEqual) * stated.solution.cost &&
                        !gives_up_closures(stated.solution.result, rival->solution.result);
    if (better && rival->beyond_doubt) return std::move(rival->solution);
    stated.beyond_doubt = !better;
  }
  count_discarded(rival->solution.result);
  return std::nullopt;
}

void Starts::from_first_estimate() {
  PoseProblem problem = problem_;
  Solution out;
  out.poses = given_.start;
  RobustSolver solver(given_, gross_, problem, equations_, out.poses);
  solver.solve();
  finish(solver, GncStart::kFirstEstimate, out);
  keep_better(std::move(out));
}

void Starts::from_chordal() {
  std::vector<char> chosen(gross_.excluded.size());
  for (std::size_t k = 0; k < chosen.size(); ++k) chosen[k] = gross_.excluded[k] != 0 ? 0 : 1;
  PoseProblem problem = problem_;
  Solution out = chordal_of(problem, chosen);
  RobustSolver solver(given_, gross_, problem, equations_, out.poses);
  solver.solve();
  finish(solver, GncStart::kChordal, out);
  keep_better(std::move(out));
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
      find_gross_outliers(given_.graph, d2, given_.gnc.innovation_probability, odometry_margin);
  out.noise = gross_.noise;
  return out;
}

std::vector<char> Starts::confirmed_of(const RobustProblem& given, const std::vector<char>& wanted,
                                       double scale) const {
  const double c2 = chi_squared_quantile(given.gnc.inlier_probability, given.graph.degrees_of_freedom());
  return confirmed_closures(given.graph, given.forest, wanted, scale * c2);
}

/// The confirmed closures among some (by edge) that start a solution.
std::vector<char> Starts::seeds_among(const RobustProblem& given, std::vector<char> allowed,
                                      const GrossOutliers& gross) const {
  const double scale = scale_of_seeds(gross);
  if (gross.scale >= 1.0) return confirmed_of(given, allowed, scale);
  const double limit =
      scale * chi_squared_quantile(given.gnc.innovation_probability, given.graph.degrees_of_freedom());
  for (std::size_t k = 0; k < allowed.size(); ++k) {
    if (d2_[k] > limit) allowed[k] = 0;
  }
  return confirmed_of(given, allowed, scale);
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

/// Whether another result loses more than kMostGivenUp of the closures that one keeps.
bool Starts::gives_up_closures(const GncResult& one, const GncResult& other) const {
  std::size_t kept = 0, lost = 0;
  for (std::size_t k = 0; k < problem_.edges(); ++k) {
    if (known_inlier(given_.graph.edges()[k]) || one.weights[k] <= kKept) continue;
    ++kept;
    lost += other.weights[k] <= kKept ? 1 : 0;
  }
  return static_cast<double>(lost) > kMostGivenUp * static_cast<double>(kept);
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
