// SPDX-License-Identifier: BSD-3-Clause
#include "tie_search.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>

#include <Eigen/Dense>

#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/task.hpp>

namespace loopwise::joining {
namespace {

constexpr double kDegrees = 180.0 / 3.14159265358979323846;  // per radian
constexpr std::size_t kBatch = 64;        // pairs that are registered between two evaluations
constexpr std::size_t kMostTested = 60;   // pairs at most that test a frame
constexpr std::size_t kLeastTested = 8;   // fewer pairs are no evidence
constexpr std::size_t kManyPlaces = 4;    // with fewer, twice the share of pairs must confirm a frame
constexpr double kAgrees = 0.8;           // closures of one frame agree with more than this share
constexpr std::size_t kLeastGroup = 3;    // smaller groups are not tested
constexpr double kSameHeading_rad = 0.6;  // beyond, scans of a narrow field of view do not overlap

std::string rounded(double value, int decimals) {
  std::ostringstream out;
  out.precision(decimals);
  out << std::fixed << value;
  return out.str();
}

}  // namespace

TieSearch::TieSearch(const SearchContext& context, std::size_t a, std::size_t b, std::string name)
    : context_(context),
      a_(a),
      b_(b),
      name_(std::move(name)),
      closures_(context.paths, chi_squared_quantile(context.options.inlier_probability, 6)) {}

void TieSearch::compute(const std::vector<NodePair>& pairs) {
  TaskOptions task_options;
  task_options.use_guess = false;
  task_options.source_neighbours = static_cast<int>(context_.options.neighbours);
  task_options.target_neighbours = static_cast<int>(context_.options.neighbours);
  std::vector<NodePair> fresh;
  std::vector<RegistrationTask> tasks;
  std::set<NodePair> seen;
  for (const NodePair& pair : pairs) {
    if (outcomes_.count(pair) != 0 || !seen.insert(pair).second) continue;
    LoopCandidate candidate;
    candidate.from = context_.paths[pair.first].key;
    candidate.to = context_.paths[pair.second].key;
    candidate.source = CandidateSource::kUser;
    fresh.push_back(pair);
    tasks.push_back(make_task(context_.graph, context_.robots, candidate, task_options, /*seed=*/1,
                              [&](Key key) { return context_.paths.contains(key); }));
  }
  const auto results = compute_batch(context_.registrar, tasks, context_.threads, context_.stop);
  for (std::size_t i = 0; i < fresh.size(); ++i) {
    if (!results[i]) continue;  // stopped
    Outcome outcome;
    outcome.counts = !depends_on_circumstances(results[i]->reason);
    if (std::isfinite(results[i]->overlap)) best_overlap_ = std::max(best_overlap_, results[i]->overlap);
    if (results[i]->verified()) {
      outcome.closure = closures_.size();
      closures_.add({fresh[i].first, fresh[i].second, *results[i]->closure});
    }
    outcomes_.emplace(fresh[i], outcome);
  }
  if (context_.progress) {
    context_.progress({"joining " + name_, outcomes_.size(), std::max(planned_, outcomes_.size()),
                       std::to_string(closures_.size()) + " closures"});
  }
}

/// The key frame of a that, according to a closure, is nearest to key frame b, or farthest but within reach.
std::optional<NodePair> TieSearch::near_pair(std::size_t b, const PairClosure& by, double reach_m,
                                             bool farthest) const {
  const ComponentPaths& paths = context_.paths;
  // Chains through the closure, because odometry has the least drift near it.
  const Eigen::Isometry3d T_by = by.closure.T_from_to.inverse();
  const Eigen::Isometry3d T_a_b = paths[by.a].pose * T_by * paths[by.b].pose.inverse() * paths[b].pose;
  std::optional<NodePair> best;
  double best_m = farthest ? 0.0 : reach_m;
  for (std::size_t a = paths.begin(a_); a < paths.end(a_); ++a) {
    const double away_m = std::abs(paths[a].path_length_m - paths[by.a].path_length_m);
    if (paths[a].path != paths[by.a].path || away_m > context_.options.reach_m) continue;
    const Eigen::Isometry3d T = paths[a].pose.inverse() * T_a_b;
    const double distance = T.translation().norm();
    const bool better = farthest ? distance > best_m && distance <= reach_m : distance < best_m;
    if (!better || se3::rotation_angle(T_by.inverse() * T) > kSameHeading_rad) continue;
    best_m = distance;
    best = NodePair{b, a};
  }
  return best;
}

/// Quantile of the distance between the two ends of a group's closures.
double TieSearch::distance_of(const std::vector<std::size_t>& group, double share) const {
  std::vector<double> distances;
  distances.reserve(group.size());
  for (const std::size_t i : group) distances.push_back(closures_[i].closure.T_from_to.translation().norm());
  const auto at = static_cast<std::size_t>(share * static_cast<double>(distances.size() - 1));
  std::nth_element(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(at), distances.end());
  return distances[at];
}

/// One pair for each key frame of b: with the nearest key frame of a, or with the farthest that the
/// registration can still align.
std::vector<NodePair> TieSearch::near_pairs(const std::vector<std::size_t>& group, bool farthest) const {
  const ComponentPaths& paths = context_.paths;
  const double reach_m = farthest ? 1.25 * distance_of(group, 0.8) + 1.0
                                  : std::max(context_.options.near_m, distance_of(group, 0.5));
  std::vector<NodePair> out;
  for (std::size_t b = paths.begin(b_); b < paths.end(b_); ++b) {
    // Tries the nearest closures along the path first, until one puts a key frame of a near this one.
    std::vector<std::pair<double, std::size_t>> nearest;
    for (const std::size_t i : group) {
      const PathNode& at = paths[closures_[i].b];
      const double away_m = std::abs(at.path_length_m - paths[b].path_length_m);
      if (at.path == paths[b].path && away_m <= context_.options.reach_m) nearest.emplace_back(away_m, i);
    }
    std::sort(nearest.begin(), nearest.end());
    constexpr std::size_t kTried = 5;
    for (std::size_t k = 0; k < std::min(kTried, nearest.size()); ++k) {
      if (const auto pair = near_pair(b, closures_[nearest[k].second], reach_m, farthest)) {
        out.push_back(*pair);
        break;
      }
    }
  }
  const std::size_t most = farthest ? kMostTested / 2 : kMostTested;
  if (out.size() <= most) return out;
  std::vector<NodePair> thinned;
  for (std::size_t i = 0; i < most; ++i) thinned.push_back(out[i * out.size() / most]);
  return thinned;
}

void TieSearch::confirm(Hypothesis& hypothesis) {
  const std::vector<NodePair> pairs = near_pairs(hypothesis.group, /*farthest=*/false);
  compute(pairs);
  compute(near_pairs(hypothesis.group, /*farthest=*/true));
  hypothesis.tested = hypothesis.confirmed = 0;
  for (const NodePair& pair : pairs) {
    const auto outcome = outcomes_.find(pair);
    if (outcome == outcomes_.end() || !outcome->second.counts) continue;
    ++hypothesis.tested;
    const auto& closure = outcome->second.closure;
    if (closure && closures_.agreement(*closure, hypothesis.group) > kAgrees) ++hypothesis.confirmed;
  }
}

/// Closures that disagree with a part of a group; all closures if the group is empty. Where odometry is
/// uncertain, such a closure may agree with the other part.
std::vector<std::size_t> TieSearch::against(const std::vector<std::size_t>& group) const {
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < closures_.size(); ++i) {
    if (closures_.agreement(i, group) <= kAgrees) out.push_back(i);
  }
  return out;
}

/// The largest group of closures that contradict `best`, extended by registrations of pairs that its frame
/// puts close together.
Hypothesis TieSearch::grown(const std::vector<std::size_t>& best) {
  Hypothesis hypothesis;
  hypothesis.group = closures_.largest_group(against(best));
  if (hypothesis.group.size() < kLeastGroup) return hypothesis;
  // Pairs that confirm the frame add closures, and these put further pairs close together.
  constexpr int kRounds = 4;
  for (int round = 0; round < kRounds && !context_.stop.stop_requested(); ++round) {
    confirm(hypothesis);
    const std::vector<std::size_t> group = closures_.largest_group(against(best));
    if (group.size() <= hypothesis.group.size()) break;
    hypothesis.group = group;
  }
  return hypothesis;
}

std::pair<Hypothesis, Hypothesis> TieSearch::hypotheses() {
  Hypothesis best = grown({});
  Hypothesis rival = grown(best.group);
  if (rival.group.size() > best.group.size()) std::swap(best, rival);
  return {std::move(best), std::move(rival)};
}

std::string TieSearch::refusal(const Tie& tie) const {
  const JoinOptions& o = context_.options;
  const auto count = [](std::int64_t n) { return std::to_string(n); };
  const std::string agreeing = std::to_string(tie.closures.size()) + " closures agree";
  if (tie.closures.size() < static_cast<std::size_t>(o.min_closures))
    return agreeing + ", fewer than joining.min_closures = " + count(o.min_closures);
  if (tie.places < static_cast<std::size_t>(o.min_places))
    return agreeing + ", but from " + std::to_string(tie.places) + (tie.places == 1 ? " place" : " places") +
           ", fewer than joining.min_places = " + count(o.min_places);
  if (tie.tested < kLeastTested)
    return agreeing + ", but their frame puts only " + std::to_string(tie.tested) +
           " pairs close together, too few to confirm it";
  const double share = static_cast<double>(tie.confirmed) / static_cast<double>(tie.tested);
  const double needed = tie.places < kManyPlaces ? std::min(1.0, 2.0 * o.min_confirmed) : o.min_confirmed;
  if (share < needed)
    return agreeing + ", but only " + std::to_string(tie.confirmed) + " of " + std::to_string(tie.tested) +
           " pairs that their frame puts close together confirm it; " + rounded(100.0 * needed, 0) +
           " % are needed";
  const bool is_rival =
      tie.rival_closures >= kLeastGroup &&
      (static_cast<double>(tie.rival_closures) > o.max_rival * static_cast<double>(tie.closures.size()) ||
       tie.rival_confirmed > std::max(o.min_confirmed, o.max_rival * share));
  if (is_rival)
    return agreeing + ", but " + std::to_string(tie.rival_closures) + " others agree on another frame";
  if (tie.sigma_m > o.max_sigma_m || tie.sigma_rad > o.max_sigma_rad)
    return agreeing + ", but leave the frame uncertain by " + rounded(tie.sigma_m, 2) + " m and " +
           rounded(tie.sigma_rad * kDegrees, 2) + " deg, more than " + rounded(o.max_sigma_m, 2) + " m or " +
           rounded(o.max_sigma_rad * kDegrees, 2) + " deg";
  return {};
}

void TieSearch::judge(Tie& tie, const Hypothesis& best, const Hypothesis& rival) const {
  tie.closures.clear();
  for (const std::size_t i : best.group) tie.closures.push_back(closures_[i].closure);
  tie.computed = outcomes_.size();
  tie.verified = closures_.size();
  tie.best_overlap = best_overlap_;
  tie.places = closures_.places(best.group, context_.options.place_m);
  tie.tested = best.tested;
  tie.confirmed = best.confirmed;
  tie.rival_closures = rival.group.size() < 2 ? 0 : rival.group.size();
  tie.rival_confirmed = rival.tested < kLeastTested ? 0.0 : rival.share();
  if (best.group.size() >= 2) {
    tie.T_a_b = closures_.frame(best.group[best.group.size() / 2]);
    const Matrix6d covariance = closures_.fused_covariance(best.group);
    const auto largest = [](const Eigen::Matrix3d& block) {
      return std::sqrt(std::max(
          0.0,
          Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(block, Eigen::EigenvaluesOnly).eigenvalues()[2]));
    };
    tie.sigma_m = largest(covariance.topLeftCorner<3, 3>());
    tie.sigma_rad = largest(covariance.bottomRightCorner<3, 3>());
  }
  tie.reason = refusal(tie);
  tie.joined = tie.reason.empty();
  if (tie.joined) {
    tie.reason = std::to_string(tie.closures.size()) + " closures from " + std::to_string(tie.places) +
                 " places agree, " + std::to_string(tie.confirmed) + " of " + std::to_string(tie.tested) +
                 " pairs confirm them";
  }
}

Tie TieSearch::run(const std::vector<NodePair>& order) {
  Tie tie;
  tie.a = a_;
  tie.b = b_;
  planned_ = order.size();
  std::size_t judged_closures = 0;
  for (std::size_t begin = 0; begin < order.size() && !context_.stop.stop_requested();) {
    const std::size_t end = std::min(order.size(), begin + kBatch);
    compute({order.begin() + static_cast<std::ptrdiff_t>(begin),
             order.begin() + static_cast<std::ptrdiff_t>(end)});
    begin = end;
    const bool due = begin == order.size() || begin >= static_cast<std::size_t>(context_.options.min_pairs);
    if (!due || closures_.size() == judged_closures) continue;
    const auto [best, rival] = hypotheses();
    judged_closures = closures_.size();
    judge(tie, best, rival);
    if (tie.joined) return tie;
  }
  if (judged_closures == 0) judge(tie, {}, {});  // no closure, or stopped early
  tie.computed = outcomes_.size();
  tie.best_overlap = best_overlap_;
  return tie;
}

}  // namespace loopwise::joining
