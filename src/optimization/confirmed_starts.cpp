// SPDX-License-Identifier: BSD-3-Clause
// Starts from closures that others confirm.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "confirmed_closures.hpp"
#include "scaled_odometry.hpp"

namespace loopwise::detail {
namespace {

/// The confirmed closures start a solution of their own if they are at least kFewestConfirmed of the closures
/// that odometry does not rule out. It is graduated if the minimum with all of them loses more than
/// kMostConfirmedLost. The other starts follow if it loses more than kMostContradicting.
constexpr double kFewestConfirmed = 1.0 / 3.0;
/// If they contradict each other, those in large groups start alone, if they are at least
/// kFewestInLargeGroups of the closures. False groups may be joined to them by chance, so up to
/// kMostOfGroupsLost may be excluded.
constexpr double kFewestInLargeGroups = 0.1;
constexpr double kMostOfGroupsLost = 0.1;
constexpr double kAnyCost = std::numeric_limits<double>::infinity();
constexpr double kMostConfirmedLost = 0.01;
constexpr double kMostContradicting = 0.5;
/// Bounds on steps to the minimum with all confirmed closures, and on rounds of truncated least squares from
/// there. If they agree, half of these are enough. Large groups are a part of them: truncated least squares
/// then adds the others round by round, so that its own bound applies.
constexpr int kMostSteps = 15;
constexpr int kMostRounds = 6;
/// If the noise is far below the stated one, the innovation test has a margin. Closures within it may be
/// false; they do not start a solution, but may join it.
constexpr double kShareOfMargin = 0.16;
/// Solutions with different uncertainties of odometry differ clearly if their costs do by this share.
constexpr double kClearlyLess = 0.01;
/// Bound on starts from the confirmed closures, each with a new estimate of odometry's uncertainty.
constexpr int kConfirmedRounds = 6;

/// Variance of the noise, relative to the stated one, by which closures that start a solution agree.
double scale_of_seeds(const GrossOutliers& gross) {
  return gross.scale >= 1.0 ? gross.scale : kShareOfMargin * gross.scale;
}

}  // namespace

bool Starts::from_confirmed() {
  std::optional<FromConfirmed> found = solve_from_confirmed({}, gross_, true, Groups::kFirst);
  if (!found) return false;
  std::optional<Doubted> other;
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
  const bool beyond_doubt = found->beyond_doubt;
  if (found->settled) {
    keep_better(std::move(found->solution));
  } else {
    count_discarded(found->solution.result);
  }
  if (!other) return beyond_doubt;
  if (!other->solution.odometry_variances.empty()) {
    // If the confirmed closures lost right ones at the stated odometry, it seems worse than it is. Another
    // start with the stated odometry may then cost less.
    if (!given_.stop.stop_requested()) from_first_estimate();
    if (best_ && is_refuted_by_best(*other)) {
      count_discarded(other->solution.result);
      return false;
    }
  }
  forget();
  keep_better(std::move(other->solution));
  refine(false);
  return true;
}

/// Whether the best solution, with the stated odometry, costs less than one with doubted odometry: as it is,
/// or with odometry as uncertain as its own closures show. The latter counts only if the solutions differ by
/// more than chance in what they keep, and clearly in cost: a right closure that is excluded makes odometry
/// look better than it is, so that the cost is a little too low.
bool Starts::is_refuted_by_best(const Doubted& other) {
  if (best_->cost < (1.0 - kEqual) * other.restricted_cost) return true;
  if (!gives_up_closures(best_->result, other.solution.result, 1.0 - given_.gnc.inlier_probability))
    return false;
  const Solution rival = refined(without_counts(*best_));
  count_discarded(rival.result);
  return judged_cost(rival) < (1.0 - kClearlyLess) * other.restricted_cost;
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

  /// The confirmed closures, by edge.
  [[nodiscard]] const std::vector<char>& seeds() const { return confirmed_; }
  [[nodiscard]] bool are_few() const {
    return seeds_ == 0.0 || seeds_ < kFewestConfirmed * static_cast<double>(count(allowed_));
  }

  FromConfirmed solve(bool grow, Groups groups) {
    out_.solution.poses = chordal();
    const std::vector<Pose> start = out_.solution.poses;
    solver_.emplace(given(), gross_, problem(), starts_.equations_, out_.solution.poses);
    bool agree = agree_at_minimum();
    bool doubtful = (!grow || !agree) && is_in_doubt(gross_.excluded, seeds_);
    if (!agree && (grow || !doubtful) && groups == Groups::kFirst)
      out_.from_groups = from_large_groups(kAnyCost);
    out_.plain = agree || out_.from_groups.value_or(false);
    if (!out_.plain && !doubtful) {
      out_.solution.poses = start;
      agree = agree_after_graduation();
      const bool loses_many = !agree || lost() > kMostOfGroupsLost * seeds_;
      doubtful = !agree || lost() > kMostContradicting * seeds_;
      if (groups == Groups::kAfterwards && loses_many) {
        out_.from_groups = from_large_groups(solver_->truncated_cost());
        // The poses after graduation are back, but the solver's residuals are those of the groups.
        if (agree && !out_.from_groups.value_or(true)) solver_->minimize_with(kept_by(problem().weight));
      }
    }
    if (out_.from_groups.value_or(false)) {
      agree = true;
      doubtful = false;
    }
    if (!doubtful) explain_the_others(grow);
    if (agree) solver_->settle();  // otherwise the minimum may be many steps away, and does not count
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

  bool agree_at_minimum(int rounds = kMostRounds) {
    const auto few = [&](double number) { return number <= kMostConfirmedLost * seeds_; };
    return few(static_cast<double>(solver_->minimize_with(confirmed_, kMostSteps))) &&
           solver_->truncate(true, rounds) && few(lost());
  }

  bool agree_after_graduation(int rounds = kMostRounds) {
    solver_->graduate_with(confirmed_);
    return solver_->truncate(false, rounds);
  }

  /// Tries the closures in large groups in place of all confirmed ones. If they do not agree either, or cost
  /// more than this, the state before is restored. \returns whether they start the solution; nothing if there
  /// are no such groups to try
  std::optional<bool> from_large_groups(double cost) {
    if (given().stop.stop_requested()) return std::nullopt;
    std::vector<char> large = starts_.in_large_groups_of(given(), confirmed_, gross_);
    if (large == confirmed_ ||
        static_cast<double>(count(large)) < kFewestInLargeGroups * static_cast<double>(count(allowed_)))
      return std::nullopt;
    const std::vector<char> confirmed = confirmed_, kept = kept_by(problem().weight);
    const std::vector<Pose> poses = out_.solution.poses;
    choose(std::move(large));
    out_.solution.poses = chordal();
    constexpr int kRounds = RobustSolver::kTruncatedRounds;
    const bool agree = agree_at_minimum(kRounds) ||
                       (agree_after_graduation(kRounds) && lost() <= kMostOfGroupsLost * seeds_);
    if (agree && solver_->truncated_cost() < cost) return true;
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
/// allows. Nothing if they are few. If they contradict each other, those in large groups start alone, or the
/// solution is graduated among all of them, unless it is in doubt anyway because of those that odometry rules
/// out. \param grow whether to re-admit closures as well
std::optional<Starts::FromConfirmed> Starts::solve_from_confirmed(const OdometryVariances& variances,
                                                                  const GrossOutliers& gross, bool grow,
                                                                  Groups groups) {
  ConfirmedStart start(*this, variances, gross);
  if (start.are_few()) return std::nullopt;
  return start.solve(grow, groups);
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

/// What the excluded closures of a solution cost less if those that confirm each other count as a group, n of
/// them as √n: one place that looks like another gives many false closures that agree. The cost that they
/// would have as right ones is not reduced, so that no group is cheaper to exclude than to keep.
double Starts::discount_of_groups(const Solution& solution) const {
  std::vector<char> left_out(problem_.edges());
  for (std::size_t k = 0; k < left_out.size(); ++k) {
    const bool kept = known_inlier(given_.graph.edges()[k]) || solution.result.weights[k] > kKept;
    left_out[k] = kept ? 0 : 1;
  }
  const int freedom = given_.graph.degrees_of_freedom();
  const double c2 = chi_squared_quantile(given_.gnc.inlier_probability, freedom);
  double fewer = 0.0;
  for (const std::size_t n :
       group_sizes(given_.graph, given_.forest, left_out, scale_of_seeds(gross_) * c2)) {
    if (n > 0) fewer += 1.0 - 1.0 / std::sqrt(static_cast<double>(n));
  }
  return 0.5 * gross_.noise * std::max(0.0, c2 - freedom) * fewer;
}

/// For a start from the confirmed closures whose solution shows odometry to be worse than stated. Excluded
/// closures make odometry look better than it is, and false closures that are kept make it look worse: they
/// bend odometry, which then seems as bad as they need it. So one attempt begins with the uncertainty that is
/// `shown`, another with the largest for all chains. If neither succeeds, a third one has a margin on the
/// innovation test as well: where errors of odometry add up, the test would exclude right closures round by
/// round, since each exclusion makes odometry look better. \returns the solution of the lower restricted
/// cost, with groups of excluded closures discounted, among those that are beyond doubt and cost less than
/// the stated odometry
std::optional<Starts::Doubted> Starts::with_doubted_odometry(const FromConfirmed& stated,
                                                             const OdometryVariances& shown) {
  struct Attempt {
    OdometryVariances first;
    double margin;  // of the innovation test
  };
  const OdometryVariances widest = all_chains_with(largest_variance());
  std::vector<Attempt> attempts{{widest, 1.0}};
  if (stated.settled) {  // otherwise `shown` is not that of a minimum
    if (differ(shown, widest)) attempts.insert(attempts.begin(), {shown, 1.0});
    attempts.push_back({widest, given_.gnc.odometry_margin});
  }
  const auto discounted = [this](const Doubted& of) {
    return of.restricted_cost - discount_of_groups(of.solution);
  };
  std::optional<Doubted> best;
  std::vector<Round> tried;
  for (const auto& [first, margin] : attempts) {
    if (best && margin > 1.0) break;
    std::optional<Doubted> found = settled_odometry(first, margin, tried);
    if (!found) continue;
    const bool worse = stated.settled && (gives_up_closures(stated.solution.result, found->solution.result) ||
                                          found->restricted_cost > stated.solution.cost);
    if (worse || (best && discounted(*best) <= discounted(*found))) {
      count_discarded(found->solution.result);
      continue;
    }
    if (best) count_discarded(best->solution.result);
    best = std::move(found);
  }
  return best;
}

/// Alternates between a start from the closures that are confirmed with odometry of some uncertainty, and the
/// estimate of the uncertainty at its solution, until this no longer changes. \param margin of the innovation
/// test, relative to that uncertainty \param tried rounds of earlier attempts, which are not computed again;
/// a margin that adds no closures to those that start a round adds nothing to it \returns the solution if it
/// is then beyond doubt, and the largest uncertainty explains its residuals; nothing if an earlier attempt
/// has come to it
std::optional<Starts::Doubted> Starts::settled_odometry(OdometryVariances used, double margin,
                                                        std::vector<Round>& tried) {
  // A large group that agrees may be the error of a slip that bends the path. So graduation comes first; the
  // way of the lower cost is then taken in each round.
  Groups groups = Groups::kAfterwards;
  for (int number = 0; number < kConfirmedRounds && !given_.stop.stop_requested(); ++number) {
    const Scaled scaled(*this, used);
    const GrossOutliers gross =
        gross_outliers_of(innovations(scaled.given().graph, scaled.given().forest), margin);
    ConfirmedStart start(*this, used, gross);
    if (start.are_few()) return std::nullopt;
    const auto same = std::find_if(tried.begin(), tried.end(), [&](const Round& round) {
      return round.used == used && round.seeds == start.seeds() && round.groups == groups;
    });
    if (same != tried.end()) {
      if (same->last) return std::nullopt;
      used = same->next_used;
      groups = same->next_groups;
      continue;
    }
    tried.push_back({used, start.seeds(), groups, {}, groups, true});
    FromConfirmed found = start.solve(false, groups);
    if (found.from_groups) groups = *found.from_groups ? Groups::kFirst : Groups::kNot;
    std::optional<OdometryEstimate> estimate = estimated_variances(found.solution, true);
    const bool is_worse = estimate && !estimate->variances.empty();
    const bool has_settled = is_worse && !differ(estimate->variances, used);
    // Beyond the largest uncertainty, false closures are more likely than odometry of that kind.
    if (has_settled && found.beyond_doubt && !estimate->beyond_largest) {
      const double restricted_cost = found.solution.cost + 0.5 * gross_.noise * estimate->log_determinant;
      return Doubted{std::move(found.solution), restricted_cost};
    }
    count_discarded(found.solution.result);
    if (!is_worse || has_settled) return std::nullopt;
    used = std::move(estimate->variances);
    tried.back().next_used = used;
    tried.back().next_groups = groups;
    tried.back().last = false;
  }
  return std::nullopt;
}

/// For a start from the confirmed closures that is in doubt, although its closures do not show odometry to be
/// worse than stated: odometry may have slipped once. Starts from the closures that are confirmed and that
/// odometry of the largest uncertainty allows, with odometry as uncertain as they show it to be, and drops
/// the doubt if this solution costs more. \returns the solution if it costs less and is beyond doubt itself
std::optional<Starts::Doubted> Starts::with_doubted_test(FromConfirmed& stated) {
  std::optional<FromConfirmed> rival =
      solve_from_confirmed({}, gross_outliers_of(d2_, given_.gnc.odometry_margin), true, Groups::kFirst);
  if (!rival) return std::nullopt;
  if (rival->settled) {
    rival->solution = refined(std::move(rival->solution));
    const double cost = judged_cost(rival->solution);
    const bool better = cost < (1.0 - kEqual) * stated.solution.cost &&
                        !gives_up_closures(stated.solution.result, rival->solution.result);
    if (better && rival->beyond_doubt) return Doubted{std::move(rival->solution), cost};
    stated.beyond_doubt = !better;
  }
  count_discarded(rival->solution.result);
  return std::nullopt;
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

}  // namespace loopwise::detail
