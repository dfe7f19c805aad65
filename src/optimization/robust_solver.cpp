// SPDX-License-Identifier: BSD-3-Clause
#include "robust_solver.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "confirmed_closures.hpp"
#include "gnc_solver.hpp"
#include "noise_tail.hpp"

namespace loopwise::detail {
namespace {

/// Factors on the estimated variance of the noise, for heavy tails. A closure that the innovation test
/// excludes may return, one that truncated least squares excludes may not.
constexpr double kNoiseMargin = 25.0;
constexpr double kTruncationMargin = 400.0;
/// If closures that are near each other show more noise than the odometry does, by this factor, the stated
/// information is wrong in its form, not in its scale.
constexpr double kMostApart = 2.0;

}  // namespace

/// The threshold assumes that the stated information is correct. If it is far too pessimistic
/// (parking-garage: by 10⁶), true closures are far below the threshold, and false ones may be too. So the
/// noise is first measured at the lower quartile of d², which remains valid if up to half of the closures are
/// false. The threshold is lowered with the noise, with a margin for heavy tails, and never raised. Closures
/// that repeat the odometry up to rounding (computed from it, or registered from the same scans) are not
/// counted, because they contain no information on the noise: if a quarter of the closures were such, the
/// threshold would be 0 and exclude all others.
GrossOutliers find_gross_outliers(const PoseGraph& graph, const std::vector<double>& d2, double probability,
                                  double odometry_margin, double least_scale) {
  constexpr std::size_t kFewest = 8;
  // Smaller values are not noise: with information that is pessimistic by 10⁶, one true closure in 50 000 has
  // a smaller d². The scale is therefore at least 7e-7.
  constexpr double kLeast = 1e-7;
  GrossOutliers gross{std::vector<char>(graph.edges().size(), 0)};
  if (probability >= 1.0) return gross;
  const int dof = graph.degrees_of_freedom();
  std::vector<double> known;
  for (const double d : d2) {
    if (d >= kLeast) known.push_back(d);
  }
  if (known.size() >= kFewest) {
    const auto quartile = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 4);
    std::nth_element(known.begin(), quartile, known.end());
    gross.scale = std::clamp(kNoiseMargin * *quartile / chi_squared_quantile(0.25, dof), least_scale, 1.0);
  }
  const double threshold =
      odometry_margin * odometry_margin * gross.scale * chi_squared_quantile(probability, dof);
  for (std::size_t k = 0; k < d2.size(); ++k) gross.excluded[k] = d2[k] > threshold ? 1 : 0;
  return gross;
}

double measure_noise(const PoseGraph& graph, const OdometryForest& forest, double c2, GrossOutliers& gross) {
  std::vector<double> d2 = innovations_of_neighbours(graph, forest);
  if (d2.empty()) return 0.0;
  const double near = noise_of_neighbours(d2, graph.degrees_of_freedom());
  gross.noise = std::clamp(kTruncationMargin * near, gross.scale, 1.0);
  if (near <= kMostApart * gross.scale / kNoiseMargin)
    gross.measured = std::max(near, gross.scale / kNoiseMargin);
  const double low = gross.noise * c2;
  if (low >= c2) return 0.0;
  const double end = end_of_tail(std::move(d2), low, c2);
  gross.noise = end / c2;
  return end > low ? gross.noise : 0.0;
}

namespace {

/// Residuals beyond this multiple of c² are treated as infinite: graduation starts no farther out.
constexpr double kFarthestStart = 1e6;
/// Closures that others confirm are mostly right, so that graduation among them needs fewer values of μ.
constexpr int kStepsAtOnce = 3;
/// A minimum is near enough to decide about closures if the last step lowers the cost by less than this share
/// of the threshold. A step with a full Gauss-Newton matrix then leaves far less.
constexpr double kEnough = 1e-4;
/// Bound on attempts to re-admit closures, each of which must lower the truncated cost.
constexpr int kGrowthAttempts = 30;
constexpr double kLeastGain = 1e-9;
/// Bounds on the closures that are tested with the covariance of the whole solution: their number, and above
/// kFewExact also their number times the elements of the factor, as each costs six half solutions with it.
constexpr std::size_t kFewExact = 256, kMostExact = 2048;
constexpr std::size_t kMostExactElements = 4'000'000'000;

/// Whether the poses of two nodes depend on each other: they are in one component, or priors hold both.
bool are_connected(const Freedom& freedom, std::size_t a, std::size_t b) {
  const auto is_anchored = [&](std::size_t node) {
    const std::uint32_t component = freedom.component[node];
    return component != Freedom::kFixed &&
           !std::binary_search(freedom.held.begin(), freedom.held.end(), std::size_t{component});
  };
  return (freedom.component[a] == freedom.component[b] && freedom.component[a] != Freedom::kFixed) ||
         (is_anchored(a) && is_anchored(b));
}

/// Ad(T_a⁻¹ T_b)
Matrix6d relative_adjoint(const Pose& a, const Pose& b) {
  const Eigen::Matrix3d R = a.R.transpose() * b.R;
  const Eigen::Vector3d t = a.R.transpose() * (b.t - a.t);
  Matrix6d ad = Matrix6d::Zero();
  ad.topLeftCorner<3, 3>() = ad.bottomRightCorner<3, 3>() = R;
  ad.topRightCorner<3, 3>() = se3::skew(t) * R;
  return ad;
}

}  // namespace

RobustSolver::RobustSolver(const RobustProblem& given, const GrossOutliers& gross, PoseProblem& problem,
                           NormalEquations& equations, std::vector<Pose>& poses)
    : graph_(given.graph),
      problem_(problem),
      equations_(equations),
      poses_(poses),
      start_(given.start),
      options_(given.options),
      gnc_(given.gnc),
      pool_(given.pool),
      stop_(given.stop),
      gross_(gross),
      neighbours_(given.graph, given.forest),
      stated_c2_(chi_squared_quantile(given.gnc.inlier_probability, given.graph.degrees_of_freedom())),
      c2_(truncates(given.gnc.kernel) ? gross.noise * stated_c2_ : stated_c2_),
      limit_(gross.scale * stated_c2_) {
  for (std::size_t k = 0; k < problem.edges(); ++k) {
    problem.weight[k] = 1.0;
    if (!known_inlier(given.graph.edges()[k])) closures_.push_back(k);
  }
  r2_.resize(closures_.size());
  std::vector<Vector6d> residuals;
  total_.cost_initial = problem.cost(poses, pool_, residuals);
  if (!std::isfinite(total_.cost_initial)) throw InputError("the cost of the first estimate is not finite");
  evaluate();
}

void RobustSolver::solve() {
  switch (gnc_.kernel) {
    case RobustKernel::kGncTls:
      graduate(1);
      truncate();
      grow(gross_.excluded);
      settle();
      break;
    case RobustKernel::kTls:
      truncate();
      grow(gross_.excluded);
      settle();
      break;
    case RobustKernel::kCauchy:
    case RobustKernel::kGemanMcClure:
      reweight();
      break;
  }
}

std::size_t RobustSolver::minimize_with(const std::vector<char>& chosen, int max_steps) {
  keep(chosen);
  StepControl control;
  control.max_accepted = max_steps;
  control.damping = options_.initial_damping;
  if (max_steps < kAnySteps) control.enough = kEnough * c2_;
  descend(control);
  realign_held_components();
  if (total_.termination == Termination::kMaxIterations && max_steps < kAnySteps)
    return static_cast<std::size_t>(std::count(chosen.begin(), chosen.end(), 1));
  std::size_t misfits = 0;
  for (std::size_t i = 0; i < closures_.size(); ++i) {
    misfits += chosen[closures_[i]] != 0 && r2_[i] > c2_ ? 1 : 0;
  }
  return misfits;
}

void RobustSolver::graduate_with(const std::vector<char>& chosen) {
  trusts_information_ = true;
  chosen_ = &chosen;
  evaluate();
  graduate(kStepsAtOnce);
  chosen_ = nullptr;
}

void RobustSolver::keep(const std::vector<char>& kept) {
  trusts_information_ = true;
  settled_ = false;
  for (const std::size_t k : closures_) problem_.weight[k] = kept[k] != 0 ? 1.0 : 0.0;
}

void RobustSolver::evaluate() {
  covariance_d2_.clear();
  for (std::size_t i = 0; i < closures_.size(); ++i) r2_[i] = problem_.squared_residual(closures_[i], poses_);
}

/// Whether the closure is excluded for now; it returns when the estimate agrees with it.
bool RobustSolver::is_gross_outlier(std::size_t i) const {
  if (chosen_ != nullptr && (*chosen_)[closures_[i]] == 0) return true;
  return gross_.excluded[closures_[i]] != 0 && r2_[i] > c2_;
}

/// Sets the weights of the closures. A weight within the tolerance of 0 becomes 0, so that the closure leaves
/// the sparsity structure. \returns the largest change.
template <class Weight>
double RobustSolver::set_weights(Weight&& weight) {
  double change = 0.0;
  for (std::size_t i = 0; i < closures_.size(); ++i) {
    double w = is_gross_outlier(i) ? 0.0 : weight(r2_[i]);
    if (w <= gnc_.weight_tolerance) w = 0.0;
    change = std::max(change, std::abs(w - problem_.weight[closures_[i]]));
    problem_.weight[closures_[i]] = w;
  }
  return change;
}

void RobustSolver::descend(StepControl& control) {
  OptimizationResult part;
  minimize(problem_, equations_, poses_, options_, control, pool_, stop_, part);
  part.cost_initial = total_.cost_initial;
  part.factorizations += total_.factorizations;
  for (IterationRecord& record : part.trace) record.iteration += total_.iterations;
  part.iterations += total_.iterations;
  total_.trace.insert(total_.trace.end(), part.trace.begin(), part.trace.end());
  part.trace = std::move(total_.trace);
  total_ = std::move(part);
  settled_ = control.enough == 0.0 && control.max_accepted == kAnySteps;
  evaluate();
}

/// Descends to the minimum for the present weights, as near to it as decisions about closures need.
void RobustSolver::approach_minimum() {
  StepControl control;
  control.enough = kEnough * c2_;
  control.damping = options_.initial_damping;
  descend(control);
  realign_held_components();
}

void RobustSolver::settle() {
  for (int round = 0; round < kTruncatedRounds; ++round) {
    if (!settled_) {
      StepControl control;
      control.damping = options_.initial_damping;
      descend(control);
      realign_held_components();
    }
    if (stopped() || set_truncated_weights() == 0.0) return;
    settled_ = false;
  }
}

/// Whether a stop was requested, so that the result is incomplete even if the last descent converged.
bool RobustSolver::stopped() {
  stopped_ = stopped_ || stop_.stop_requested();
  return stopped_;
}

/// Yang et al. 2020, §IV, but from the residuals of the first estimate instead of a solution with all
/// closures. False closures would distort that solution, and it requires an almost dense factorisation.
void RobustSolver::graduate(int steps_at_once) {
  double largest = 0.0;
  for (std::size_t i = 0; i < r2_.size(); ++i) {
    if (!is_gross_outlier(i)) largest = std::max(largest, r2_[i]);
  }
  double mu = c2_ / (2.0 * std::min(largest, kFarthestStart * c2_) - c2_);
  const double mu_step = std::pow(gnc_.mu_step, steps_at_once);
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
    mu *= mu_step;
  }
}

/// \returns the largest change
double RobustSolver::set_truncated_weights() {
  return set_weights([&](double r2) { return r2 <= c2_ ? 1.0 : 0.0; });
}

bool RobustSolver::truncate(bool at_minimum, int max_rounds) {
  for (int round = 0; round < max_rounds && !stopped(); ++round) {
    const double change = set_truncated_weights();
    if (change == 0.0 && (round > 0 || at_minimum)) return true;
    if (gnc_.kernel == RobustKernel::kTls) ++outer_;
    approach_minimum();
  }
  return false;
}

/// Re-admits excluded closures that agree with the kept ones around them, i.e. with d² ≤ c² by the measured
/// noise. To first order, to admit a closure costs at least ½d², and to exclude it costs ½c²; so closures
/// with d² > c² are not tried. The admitted closures stay if the truncated cost is lower. Inliers thus spread
/// from regions where odometry confirms them to regions where its uncertainty is too large.
void RobustSolver::grow(const std::vector<char>& may_grow) {
  if (!gnc_.growth) return;
  std::vector<char> tried(closures_.size(), 0);
  for (std::size_t i = 0; i < tried.size() && !may_grow.empty(); ++i) {
    tried[i] = may_grow[closures_[i]] != 0 ? 0 : 1;
  }
  int attempts = 0;
  while (!stopped()) {
    std::vector<std::size_t> agreeing = agreeing_with_kept(tried);
    if (agreeing.empty() || !admit_some(agreeing, attempts)) return;
    for (const std::size_t i : agreeing) tried[i] = 1;
  }
}

/// Tries to admit these closures, then the first quarter of them, and so on. \returns whether a part was
/// admitted; `closures` is then this part, otherwise the last part that was tried
bool RobustSolver::admit_some(std::vector<std::size_t>& closures, int& attempts) {
  while (attempts++ < kGrowthAttempts && !stopped()) {
    if (try_to_admit(closures)) return true;
    if (closures.size() == 1) break;
    closures.resize((closures.size() + 3) / 4);
  }
  return false;
}

bool RobustSolver::admit_unexplained(const std::vector<char>& among) {
  std::vector<std::size_t> number(problem_.edges());
  for (std::size_t i = 0; i < closures_.size(); ++i) number[closures_[i]] = i;
  std::vector<char> open = among;
  int attempts = 0;
  while (!stopped()) {
    const std::vector<std::size_t> edges = unexplained(open);
    if (edges.empty() || edges.size() > most_exact() || attempts >= kGrowthAttempts) return edges.empty();
    std::vector<std::pair<double, std::size_t>> by_innovation;
    for (const std::size_t k : edges) by_innovation.emplace_back(covariance_d2_[k], number[k]);
    std::sort(by_innovation.begin(), by_innovation.end());
    std::vector<std::size_t> closures;
    for (const auto& [d2, i] : by_innovation) closures.push_back(i);
    const bool admitted = admit_some(closures, attempts);
    // One that raises the cost alone is explained; larger sets are tried again without it.
    if (admitted || closures.size() == 1) {
      for (const std::size_t i : closures) open[closures_[i]] = 0;
    }
  }
  return false;
}

/// Tries the minimum with these closures too. If its truncated cost is not lower, restores poses and weights;
/// the equations are then out of date until settle(). \returns whether the cost is lower, with other closures
/// than before: further steps with the same ones lower it, too
bool RobustSolver::try_to_admit(const std::vector<std::size_t>& closures) {
  const std::vector<Pose> poses = poses_;
  const std::vector<double> weights = problem_.weight;
  const double cost = truncated_cost();
  for (const std::size_t i : closures) problem_.weight[closures_[i]] = 1.0;
  approach_minimum();
  truncate(true);
  if (!stopped() && problem_.weight != weights && truncated_cost() < cost * (1.0 - kLeastGain)) return true;
  poses_ = poses;
  problem_.weight = weights;
  settled_ = false;
  evaluate();
  return false;
}

/// Excluded closures to try, at most as many as are kept. The ones with the lowest variance across a kept
/// closure come first.
std::vector<std::size_t> RobustSolver::agreeing_with_kept(const std::vector<char>& tried) {
  std::vector<std::size_t> kept, left_out;
  for (std::size_t i = 0; i < closures_.size(); ++i) {
    if (problem_.weight[closures_[i]] > kKept) {
      kept.push_back(closures_[i]);
    } else if (tried[i] == 0) {
      left_out.push_back(i);
    }
  }
  if (left_out.empty()) return {};
  neighbours_.set_kept(kept);
  const OdometryForest rests_on = forest_of_kept();
  std::vector<std::size_t> agreeing;
  std::vector<double> variance(closures_.size());
  for (const std::size_t i : left_out) {
    if (stopped()) return {};
    const auto innovation = neighbours_(closures_[i], problem_.residual(closures_[i], poses_));
    variance[i] = innovation.variance;
    if (!(innovation.d2 <= limit_)) continue;
    if (!trusts_information_ || !contradicted(closures_[i], rests_on)) agreeing.push_back(i);
  }
  std::vector<std::size_t> edges;
  for (const std::size_t i : agreeing) edges.push_back(closures_[i]);
  if (trusts_information_) test_by_covariance(edges);
  agreeing.erase(std::remove_if(agreeing.begin(), agreeing.end(),
                                [&](std::size_t i) { return contradicts_covariance(closures_[i]); }),
                 agreeing.end());
  std::stable_sort(agreeing.begin(), agreeing.end(),
                   [&](std::size_t a, std::size_t b) { return variance[a] < variance[b]; });
  if (agreeing.size() > kept.size()) agreeing.resize(kept.size());
  return agreeing;
}

std::vector<char> RobustSolver::plausible(const std::vector<char>& known,
                                          const std::vector<char>& kept) const {
  std::vector<char> chosen(kept.size(), 0);
  for (const std::size_t k : closures_) chosen[k] = kept[k];
  const OdometryForest rests_on = forest_of(chosen);
  for (const std::size_t k : closures_) {
    if (known[k] == 0) chosen[k] = gross_.excluded[k] != 0 || contradicted(k, rests_on) ? 0 : 1;
  }
  return chosen;
}

std::vector<std::size_t> RobustSolver::unexplained(const std::vector<char>& among) {
  const OdometryForest rests_on = forest_of_kept();
  std::vector<std::size_t> out;
  for (const std::size_t k : closures_) {
    if (among[k] != 0 && problem_.weight[k] <= kKept && !contradicted(k, rests_on)) out.push_back(k);
  }
  test_by_covariance(out);
  out.erase(std::remove_if(out.begin(), out.end(), [&](std::size_t k) { return contradicts_covariance(k); }),
            out.end());
  return out;
}

/// Tests which of these closures contradict the covariance of the whole solution. Tests nothing if there are
/// too many.
void RobustSolver::test_by_covariance(const std::vector<std::size_t>& edges) {
  if (edges.size() > most_exact() || stopped()) return;
  std::vector<std::size_t> open;
  for (const std::size_t k : edges) {
    if (covariance_d2_.find(k) == covariance_d2_.end()) open.push_back(k);
  }
  if (open.empty() || !factorize_here()) return;
  const Freedom& freedom = equations_.freedom();
  const BlockCholesky& hessian = equations_.hessian();
  SparseInverse inverse(hessian.panels());
  for (const std::size_t k : open) {
    if (stopped()) return;
    // Error on the right of the relative pose: δ_to − Ad(T_to⁻¹ T_from) δ_from.
    const std::size_t from = problem_.from(k), to = problem_.to(k);
    const std::uint32_t a = freedom.variable[from], b = freedom.variable[to];
    std::vector<SparseInverse::Block> ends;
    if (b != Freedom::kFixed) {
      ends.push_back({static_cast<std::uint32_t>(hessian.position(b)), Matrix6d::Identity()});
    }
    if (a != Freedom::kFixed) {
      ends.push_back({static_cast<std::uint32_t>(hessian.position(a)),
                      -relative_adjoint(poses_[to], poses_[from]).transpose()});
    }
    const Matrix6d P = inverse.between(ends);
    // A closure between independent components cannot contradict anything.
    covariance_d2_[k] = are_connected(freedom, from, to)
                            ? squared_innovation(problem_.information(k), P, problem_.residual(k, poses_))
                            : 0.0;
  }
}

/// Number of closures that may be tested with the covariance of the whole solution.
std::size_t RobustSolver::most_exact() const {
  const auto elements = static_cast<std::size_t>(equations_.hessian().factor_nonzeros());
  return std::clamp(kMostExactElements / std::max<std::size_t>(elements, 1), kFewExact, kMostExact);
}

/// Factorises at the present poses and weights. \returns false if the factor does not exist
bool RobustSolver::factorize_here() {
  std::vector<Vector6d> residuals;
  problem_.cost(poses_, pool_, residuals);
  equations_.set_structure(problem_);
  if (equations_.hessian().variables() == 0) return false;
  equations_.linearize(problem_, poses_, residuals, pool_);
  ++total_.factorizations;
  return equations_.hessian().factorize(&pool_) &&
         equations_.hessian().smallest_pivot().first >= kSingularPivot;
}

/// The result of test_by_covariance().
bool RobustSolver::contradicts_covariance(std::size_t edge) const {
  const auto found = covariance_d2_.find(edge);
  return found != covariance_d2_.end() && found->second > limit_;
}

/// The forest over the known inliers and these closures.
OdometryForest RobustSolver::forest_of(std::vector<char> closures) const {
  for (std::size_t k = 0; k < closures.size(); ++k) {
    if (known_inlier(graph_.edges()[k])) closures[k] = 1;
  }
  return OdometryForest(graph_, closures);
}

OdometryForest RobustSolver::forest_of_kept() const {
  std::vector<char> kept(graph_.edges().size(), 0);
  for (const std::size_t k : closures_) kept[k] = problem_.weight[k] > kKept ? 1 : 0;
  return forest_of(std::move(kept));
}

bool RobustSolver::contradicted(std::size_t edge, const OdometryForest& rests_on) const {
  return innovation(graph_, rests_on, edge, problem_.residual(edge, poses_)) > limit_;
}

void RobustSolver::reweight() {
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
  equations_.set_structure(problem_);  // needed if a stop came before the first descent
  realign_held_components();
}

/// A component may have moved before it lost its last connection to a prior. Moves the whole component, at no
/// cost, so that its held node is again at the first estimate.
void RobustSolver::realign_held_components() {
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
  // A node without any remaining factor also returns to the first estimate.
  for (std::size_t i = 0; i < problem_.nodes(); ++i) {
    if (freedom.component[i] == Freedom::kFixed) poses_[i] = start_[i];
  }
  evaluate();
}

void RobustSolver::report(GncResult& result) {
  total_.factorizations += result.optimization.factorizations;  // of the first estimate
  equations_.set_structure(problem_);  // the caller reads its components, even if nothing was solved
  if (stopped_ || total_.termination == Termination::kStopped) set_termination(Termination::kStopped, total_);
  result.optimization = std::move(total_);
  result.outer_iterations = outer_;
  result.weights.assign(problem_.weight.begin(),
                        problem_.weight.begin() + static_cast<std::ptrdiff_t>(problem_.edges()));
  for (const std::size_t k : closures_) ++(problem_.weight[k] > kKept ? result.inliers : result.outliers);
  result.truncated_cost = detail::truncated_cost(graph_, problem_, poses_, stated_c2_);
}

double RobustSolver::truncated_cost() const {
  return detail::truncated_cost(graph_, problem_, poses_, c2_);
}

}  // namespace loopwise::detail
