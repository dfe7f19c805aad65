// SPDX-License-Identifier: BSD-3-Clause
#include "pose_search.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include <loopwise/core/se3.hpp>

#include "../core/constants.hpp"
#include "pose_scores.hpp"
#include "rivals.hpp"
#include "sort_falling.hpp"
#include "submap_errors.hpp"
#include "surface.hpp"

namespace loopwise {
namespace {

// Weight of the share of points on surfaces. It is low, because in a periodic hall two scans share less at
// the true pose than at a pose that puts one sensor at the other. Surfaces that only one scan sees hardly
// count against a pose.
constexpr double kShareWeight = 0.1;
constexpr double kComparableShare = 0.35;
// Part of the overlap of a pose that its rivals need, also for those nearer to the guess.
constexpr double kRivalPart = 0.85, kFavouredPart = 0.6;
constexpr int kSettlingPoints = 600;
constexpr int kQuickPoints = 300;  // that measure a pose before it settles
constexpr float kNearM =
    1.0F;  // Rivals start off by up to half a cell of the votes or half a bin of the compass.
constexpr double kAttractionM = 2.0, kAttractionRad = 15.0 * kDegree;  // Such starts converge to one pose.
constexpr std::size_t kRivalsOfTurn = 6, kScoredRivals = 32, kTriedRivals = 12;
// How far a pose may be below the tests before it settles, and before its last pass. In simulated worlds and
// on scans of 64 beams, closures have 0.9 of the required overlap after the coarse passes and lack 0.35 of
// the consistency at most; the last pass changes the consistency by less than 0.2.
constexpr double kCoarsePart = 0.7, kCoarseMissing = 0.65;
constexpr double kSettledPart = 0.85, kSettledMissing = 0.2;
// By how much the consistency of a rival may rise when it settles. Of 38 rivals that fitted a pose to 0.15,
// in two simulated missions, the worst was 0.28 below its fit before.
constexpr double kUnsettledMissing = 0.35;
// A direction is fixed below the deviation kFixedM and free above kFreeM. For a free direction, poses at the
// distance kMovedM are refined; those that end within kLeastM have converged back.
constexpr double kFixedM = 0.2, kFreeM = 1.0, kMovedM = 2.0, kLeastM = 0.3;
// With a larger bound on the overlap than this default, a smaller overlap never suffices.
constexpr double kLargestMinOverlap = 0.4;
// Largest deviation of a closure with less than min_overlap. In simulated worlds, half of the wrong poses
// with so little overlap that pass the other tests have more, but only a tenth of the right ones below 1 m.
constexpr double kSlidingM = 0.5;

/// Whether a pose is outside the 99.9 % region of a closure (χ² with six degrees of freedom).
bool excluded(const Vector6d& offset, const Matrix6d& covariance) {
  constexpr double kChiSquare = 22.46;
  return offset.dot(covariance.ldlt().solve(offset)) > kChiSquare;
}

/// The tests with the smallest overlap that may suffice.
ClosureTestOptions with_least_overlap(const FastRegistrarOptions& options) {
  ClosureTestOptions tests = options.tests;
  if (tests.min_overlap <= kLargestMinOverlap)
    tests.min_overlap = std::min(tests.min_overlap, options.min_certain_overlap);
  return tests;
}

/// Whether the overlap of a pose reaches this part of the overlap that a closure needs.
bool overlaps(const AlignmentFigures& figures, double part, const ClosureTestOptions& options) {
  const double balanced = options.min_balanced_overlap * (1.0 - missing_overlap(figures, options));
  return figures.overlap >= part * options.min_overlap * figures.expected_overlap &&
         figures.balanced_overlap >= part * balanced * figures.expected_overlap;
}

/// Whether a rival of a pose nearly has min_overlap, or the overlap of the pose if that is smaller. With less
/// overlap, only a patch of ground or wall matches, and such a patch fits nearly anywhere. A rival that the
/// guess favours needs less: in a periodic hall, the true pose often overlaps less than a wrong one.
bool nearly_overlaps(const AlignmentFigures& rival, const AlignmentFigures& pose, bool favoured,
                     const ClosureTestOptions& options) {
  const double part = favoured ? kFavouredPart : kRivalPart;
  const double needed = part * std::min(options.min_overlap, pose.overlap / pose.expected_overlap);
  const double balanced = part * options.min_balanced_overlap *
                          std::min(1.0, pose.overlap / (pose.expected_overlap * options.min_overlap));
  return rival.overlap >= needed * rival.expected_overlap &&
         rival.balanced_overlap >= balanced * rival.expected_overlap;
}

/// Whether a pose that is not refined to the end may still pass the tests: it has `part` of the required
/// overlap and at most `missing` less than the required consistency.
bool may_pass(const AlignmentFigures& figures, double part, double missing,
              const ClosureTestOptions& options) {
  return overlaps(figures, part, options) &&
         (options.min_consistency == 0.0 || consistency(figures) >= options.min_consistency - missing);
}

/// Whether an offset is along a direction that a closure hardly constrains. Translation and rotation must
/// each be within eight standard deviations, with two degrees of uncertainty of the direction. The periods of
/// a structure are about a hundred deviations away.
bool along_free_direction(const Vector6d& offset, const Matrix6d& covariance) {
  constexpr double kDeviations = 8.0, kDirectionRad = 0.035;
  const auto within = [&](Eigen::Index part) {
    const Eigen::Vector3d d = offset.segment<3>(part);
    Eigen::Matrix3d C = covariance.block<3, 3>(part, part);
    C.diagonal().array() += kDirectionRad * kDirectionRad * d.squaredNorm();
    return d.dot(C.ldlt().solve(d)) <= kDeviations * kDeviations;
  };
  return within(0) && within(3);
}

}  // namespace

bool far_apart(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, const Eigen::Vector3d& centre) {
  return (a * centre - b * centre).norm() > 1.0 || se3::rotation_angle(a.inverse() * b) > 5.0 * kDegree;
}

PoseSearch::PoseSearch(const Side& source, const Side& target, const RegistrationTask& task,
                       const FastRegistrarOptions& options, RegistrationResult& result)
    : source_(source),
      target_(target),
      task_(task),
      options_(options),
      least_(with_least_overlap(options)),
      result_(result),
      passes_(gicp_passes(options.coarse_reach_m, options.fine_reach_m,
                          static_cast<std::size_t>(options.coarse_points),
                          static_cast<std::size_t>(options.fine_points))),
      followed_(target.submap.tree(), source.order.size()) {
  fine_pass_ = {passes_.back()};
  passes_.pop_back();
}

/// The bounds of the last test of a closure, with a slack.
bool PoseSearch::within_bounds(const Eigen::Isometry3d& T_target_source, double slack_m,
                               double slack_rad) const {
  if (!task_.guess_from_to) return true;
  const Vector6d moved = moved_from_guess(*task_.guess_from_to, T_target_source.inverse());
  return moved.head<3>().norm() <= options_.tests.max_translation_m + slack_m &&
         moved.tail<3>().norm() <= options_.tests.max_rotation_rad + slack_rad;
}

double PoseSearch::expected_on_plane() const {
  return 0.5 * (source_.share.on_plane + target_.share.on_plane);
}

double PoseSearch::share_of(const Eigen::Isometry3d& T_target_source, std::size_t points) const {
  return share_on_surface(source_, points, target_, T_target_source, options_.tests, followed_) /
         (expected_on_plane() * target_.share.overlap);
}

GicpResult PoseSearch::gicp(const Eigen::Isometry3d& start, const std::vector<GicpPass>& passes) const {
  return refine_gicp(surface_of(source_.submap.cloud()), source_.centre, source_.order,
                     surface_of(target_.submap.cloud()), followed_, start, passes);
}

/// Figures of a pose. The expected share on planes is that of whole scans unless `expectation` is given.
AlignmentFigures PoseSearch::figures_of(const Eigen::Isometry3d& T_target_source,
                                        const ClosureTestOptions& tests,
                                        const PlaneExpectation* expectation) const {
  AlignmentFigures figures = measure_alignment(source_.submap.cloud(), target_.submap.cloud(),
                                               target_.submap.tree(), T_target_source, tests, expectation);
  if (expectation == nullptr) figures.expected_on_plane = expected_on_plane();
  // In sparse scans of long range, fewer than half of the points have a neighbour.
  figures.expected_overlap = std::min(1.0, 2.0 * target_.share.overlap);
  constexpr std::size_t kLookedAt = 1000;
  figures.contradiction = std::max(0.0, contradiction(source_, target_, T_target_source, kLookedAt));
  return figures;
}

double PoseSearch::refine(const Eigen::Isometry3d& start) {
  Pose pose;
  pose.T_target_source = gicp(start, passes_).T_target_source;
  if (!pose.T_target_source.matrix().allFinite() || !allowed(pose.T_target_source)) return 0.0;
  pose.share = share_of(pose.T_target_source, static_cast<std::size_t>(options_.score_points));
  add(pose);
  return pose.share;
}

std::vector<GicpPass> PoseSearch::quick_passes() const {
  std::vector<GicpPass> quick = passes_;
  for (GicpPass& pass : quick) pass.points = std::min(pass.points, few_points());
  return quick;
}

void PoseSearch::refine_coarsely(const Eigen::Isometry3d& start) {
  Pose pose;
  pose.T_target_source = gicp(start, quick_passes()).T_target_source;
  const auto same = [&](const Pose& other) {
    return !far_apart(other.T_target_source, pose.T_target_source, source_.centre);
  };
  if (!pose.T_target_source.matrix().allFinite() || !allowed(pose.T_target_source) ||
      std::any_of(poses_.begin(), poses_.end(), same)) {
    return;
  }
  pose.share = share_of(pose.T_target_source, few_points());
  add(pose);
}

void PoseSearch::add(const Pose& pose) {
  const auto worse = [&](const Pose& other) { return other.share < pose.share; };
  poses_.insert(std::find_if(poses_.begin(), poses_.end(), worse), pose);
}

/// Judges a pose by the tests of a closure. If few points clearly reject it, the refinement with all points
/// is skipped.
PoseSearch::Judgement PoseSearch::judge(Pose& pose) const {
  Judgement out;
  out.result = result_;
  out.result.closure.reset();
  const Eigen::Isometry3d start = pose.T_target_source;
  fit_of(pose);
  bool converged = true;
  out.T_target_source = pose.T_target_source;
  if (clearly_slides(pose, out)) return out;
  if (may_pass(pose.figures, kSettledPart, kSettledMissing, least_)) {
    const GicpResult settled = gicp(start, fine_pass_);
    out.T_target_source = settled.T_target_source;
    converged = settled.converged;
    const PlaneExpectation expectation{source_.neighbours(options_.tests), target_.neighbours(options_.tests),
                                       expected_on_plane()};
    out.figures = figures_of(out.T_target_source, options_.tests, &expectation);
  } else {
    ClosureTestOptions tests = options_.tests;
    tests.measured_points = kSettlingPoints;
    out.figures = figures_of(out.T_target_source, tests);
  }
  judge_alignment(out.result, out.T_target_source.inverse(), out.figures, converged, task_.guess_from_to,
                  least_);
  return out;
}

/// Offset from the closure to another pose, in the coordinates of the closure's covariance.
Vector6d PoseSearch::Judgement::offset_to(const Eigen::Isometry3d& other_target_source) const {
  return se3::log(result.closure->T_from_to.inverse() * other_target_source.inverse());
}

std::vector<GicpPass> PoseSearch::settle_pass() const {
  return {{options_.fine_reach_m, kSettlingPoints, 10, 2e-3, 2e-4}};
}

/// Fit of a pose for the comparison of poses: min(1, consistency) + ln(share on surfaces) / 10. Refines the
/// pose first, because the coarse passes may leave an error of a degree.
double PoseSearch::fit_of(Pose& pose) const {
  if (pose.fit) return *pose.fit;
  pose.T_target_source = gicp(pose.T_target_source, settle_pass()).T_target_source;
  ClosureTestOptions tests = options_.tests;
  tests.measured_points = kSettlingPoints;
  tests.fitness_range_m = tests.overlap_distance_m;  // points farther away do not count
  pose.share = share_of(pose.T_target_source, static_cast<std::size_t>(options_.score_points));
  pose.figures = figures_of(pose.T_target_source, tests);
  // A consistency above 1 exceeds that of neighbours within a scan and is no further evidence.
  pose.fit = std::min(1.0, consistency(pose.figures)) + kShareWeight * std::log(std::max(1e-6, pose.share));
  return *pose.fit;
}

/// The best pose that no test has refused, by its fit, among those with a share near the largest one. A pose
/// within the bounds about the guess is better than any outside. Null if all are refused.
PoseSearch::Pose* PoseSearch::best_in_detail() {
  const auto inside = [&](const Pose& pose) { return within_bounds(pose.T_target_source, 0.0, 0.0); };
  Pose* best = nullptr;
  const double least = kComparableShare * poses_.front().share;
  for (Pose& other : poses_) {
    if (other.refused || other.share < least) continue;
    if (best == nullptr) {
      best = &other;
      continue;
    }
    if (!far_apart(other.T_target_source, best->T_target_source, source_.centre)) continue;
    const double fit = fit_of(other), best_fit = fit_of(*best);  // refines both
    const bool better = inside(other) == inside(*best) ? fit > best_fit : inside(other);
    if (better) best = &other;
  }
  return best;
}

/// Whether the refinement may move one pose to the other.
bool PoseSearch::attracts(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) const {
  return (a * source_.centre - b * source_.centre).norm() < kAttractionM &&
         se3::rotation_angle(a.inverse() * b) < kAttractionRad;
}

/// Starts for rivals of a pose: those with enough points near the target, most points first. Of starts that
/// converge to one pose, only the first is kept.
std::vector<Eigen::Isometry3d> PoseSearch::starts_of_rivals(const Eigen::Isometry3d& best) const {
  const auto near = [&](const Eigen::Isometry3d& T) {
    return near_share(source_, static_cast<std::size_t>(options_.score_points) / 4, target_, T, kNearM);
  };
  double max_turn_rad = kPi;
  if (task_.guess_from_to) {
    max_turn_rad = options_.tests.max_rotation_rad + se3::rotation_angle(*task_.guess_from_to * best);
  }
  struct Scored {
    Eigen::Isometry3d T_target_source;
    double near;
  };
  std::vector<Scored> scored;
  for (const Eigen::Isometry3d& rival : find_rivals(source_, target_, best, max_turn_rad, kRivalsOfTurn,
                                                    [&](const auto& T) { return allowed(T); })) {
    if (scored.size() == kScoredRivals) break;
    scored.push_back({rival, near(rival)});
  }
  sort_falling(scored, [](const Scored& rival) { return rival.near; });
  const double least = kComparableShare * near(best);
  std::vector<Eigen::Isometry3d> starts;
  for (const Scored& rival : scored) {
    if (rival.near < least || starts.size() == kTriedRivals) break;
    const auto close = [&](const Eigen::Isometry3d& other) { return attracts(other, rival.T_target_source); };
    if (std::none_of(starts.begin(), starts.end(), close)) starts.push_back(rival.T_target_source);
  }
  return starts;
}

/// Adds rivals of a verified pose until one fits as well as the pose. Returns false if the time runs out.
bool PoseSearch::add_rivals(Pose& best, const Judgement& found, const Deadline& deadline) {
  // Most rivals converge back to the pose itself, and few points suffice to find that out.
  const std::size_t few = few_points();
  const std::vector<GicpPass> quick = quick_passes();
  const double least = kComparableShare * share_of(best.T_target_source, few);
  const bool is_fixed = found.result.closure->covariance.diagonal().head<3>().maxCoeff() < kFixedM * kFixedM;
  const double least_consistency = fit_of(best) - options_.ambiguous_margin - kUnsettledMissing;
  ClosureTestOptions tests = options_.tests;
  tests.measured_points = kQuickPoints;
  tests.fitness_range_m = tests.overlap_distance_m;  // points farther away do not count
  for (const Eigen::Isometry3d& start : starts_of_rivals(best.T_target_source)) {
    if (deadline.passed()) return false;
    Pose rival;
    rival.T_target_source = gicp(start, quick).T_target_source;
    const auto same = [&](const Pose& pose) {
      return !far_apart(pose.T_target_source, rival.T_target_source, source_.centre);
    };
    if (!rival.T_target_source.matrix().allFinite() || std::any_of(poses_.begin(), poses_.end(), same) ||
        share_of(rival.T_target_source, few) < least) {
      continue;
    }
    if (consistency(figures_of(rival.T_target_source, tests)) < least_consistency) continue;
    if (attracts(rival.T_target_source, best.T_target_source)) {
      rival.T_target_source = gicp(rival.T_target_source, passes_).T_target_source;
    }
    const double lead = fit_of(rival) - fit_of(best);
    add(rival);
    // In a free direction many rivals may fit, and the covariance needs all of them. Otherwise one is enough.
    if (is_fixed && nearly_overlaps(rival.figures, found.figures, favours(rival, found), options_.tests) &&
        std::abs(lead) < options_.ambiguous_margin && differs(rival, found))
      break;
  }
  return true;
}

/// Widens the covariance along axes that the points leave undecided.
void PoseSearch::widen(Judgement& found) const {
  Matrix6d& covariance = found.result.closure->covariance;
  for (const UndecidedAxis& undecided :
       undecided_axes(source_, static_cast<std::size_t>(options_.score_points), target_,
                      found.T_target_source, found.figures, options_.free_share, options_.tests)) {
    widen_covariance(covariance, undecided.axis, undecided.sigma_m);
    if (undecided.sigma_m < kFreeM) continue;
    // Refined poses further along the axis show how well the direction is known and which rotation is coupled
    // to it.
    for (const double along_m : {-kMovedM, kMovedM}) {
      Eigen::Isometry3d moved = found.T_target_source;
      moved.pretranslate(along_m * undecided.axis);
      const Vector6d offset = found.offset_to(gicp(moved, settle_pass()).T_target_source);
      if (offset.allFinite() && offset.head<3>().norm() > kLeastM) covariance += offset * offset.transpose();
    }
  }
  covariance = (0.5 * (covariance + covariance.transpose())).eval();
}

/// Whether a pose that the guess allows is distinct from the closure that was found.
bool PoseSearch::differs(const Pose& pose, const Judgement& found) const {
  const bool settled = pose.fit.has_value();
  return far_apart(pose.T_target_source, found.T_target_source, source_.centre) &&
         excluded(found.offset_to(pose.T_target_source), found.result.closure->covariance) &&
         within_bounds(pose.T_target_source, settled ? 0.0 : options_.coarse_reach_m,
                       settled ? 0.0 : kSlackRad);
}

/// Whether a pose is nearer to the guess than the closure by more than the error of a voted pose.
bool PoseSearch::favours(const Pose& pose, const Judgement& found) const {
  if (!task_.guess_from_to) return false;
  const auto off = [&](const Eigen::Isometry3d& T_target_source) {
    return moved_from_guess(*task_.guess_from_to, T_target_source.inverse()).head<3>().norm();
  };
  return off(pose.T_target_source) + kNearM < off(found.T_target_source);
}

/// Leaves out poses that fail the tests by far even before they settle, which costs ten times as much as this
/// check. Rejects the pair if no pose is left. \returns whether it is rejected
bool PoseSearch::refuse_hopeless() {
  ClosureTestOptions tests = least_;
  tests.measured_points = kQuickPoints;
  std::list<Pose> hopeful;
  const Pose* best = nullptr;
  AlignmentFigures most;
  for (const Pose& pose : poses_) {
    const AlignmentFigures figures = figures_of(pose.T_target_source, tests);
    if (may_pass(figures, kCoarsePart, kCoarseMissing, tests)) hopeful.push_back(pose);
    if (best != nullptr && figures.overlap <= most.overlap) continue;
    best = &pose;
    most = figures;
  }
  if (hopeful.empty()) {
    judge_alignment(result_, best->T_target_source.inverse(), most, /*converged=*/true, task_.guess_from_to,
                    tests);
    poses_.clear();
    return true;
  }
  poses_ = std::move(hopeful);
  return false;
}

bool PoseSearch::decide(const Deadline& deadline) {
  if (refuse_hopeless()) return true;
  Pose* best = best_in_detail();
  if (best == nullptr) return true;
  const auto judge_and_widen = [&](Pose& pose) {
    Judgement judged = judge(pose);
    if (judged.result.verified()) widen(judged);
    refuse_if_sliding(judged);
    pose.refused = !judged.result.verified();
    return judged;
  };
  Judgement found = judge_and_widen(*best);
  if (found.result.verified()) {
    if (!add_rivals(*best, found, deadline)) return false;
    Pose* better = best_in_detail();
    if (better != nullptr && better != best && fit_of(*better) > fit_of(*best) + options_.ambiguous_margin) {
      // If the better pose fails a test, the first pose stays, and refuse_if_ambiguous() compares the two.
      Judgement other = judge_and_widen(*better);
      if (other.result.verified()) {
        found = std::move(other);
        best = better;
      }
    }
    refuse_if_ambiguous(*best, found);
    refuse_if_sliding(found);
    best->refused = !found.result.verified();
  }
  if (found.result.verified()) {
    found.result.closure->covariance += submap_errors(source_.submap, target_.submap, task_,
                                                      found.T_target_source, found.figures, options_.tests);
  }
  result_ = std::move(found.result);
  return true;
}

/// Refuses a closure with less than min_overlap that may slide: few surfaces in common that leave a direction
/// free fit nearly anywhere along it. This is final, as for other degenerate poses: in simulated tunnels and
/// mines, descriptors find another pose for none of 400 such pairs.
void PoseSearch::refuse_if_sliding(Judgement& judged) const {
  if (!judged.result.verified()) return;
  const double variance = judged.result.closure->covariance.diagonal().head<3>().maxCoeff();
  refuse_if_sliding(judged, options_.tests.min_overlap, std::sqrt(variance), kSlidingM);
}

/// The same with bounds on the overlap and on the standard deviation. \returns whether it is refused
bool PoseSearch::refuse_if_sliding(Judgement& judged, double min_overlap, double sigma_m,
                                   double max_sigma_m) const {
  const double overlap = judged.figures.overlap / judged.figures.expected_overlap;
  if (overlap >= min_overlap || sigma_m < max_sigma_m) return false;
  RegistrationResult& result = judged.result;
  result.closure.reset();
  result.reason = RejectionReason::kDegenerate;
  result.message = "overlap " + std::to_string(overlap) + " with a standard deviation of " +
                   std::to_string(sigma_m) + " m, must be >= " + std::to_string(options_.tests.min_overlap) +
                   " or below " + std::to_string(kSlidingM) + " m";
  return true;
}

/// Whether a settled pose passes all tests, but slides by so much that the last pass hardly changes it. If
/// so, `judged` is refused. This spares a third of the time of such a pair, and a fifth of all pairs in a
/// simulated mine are such. Of 208 closures with little overlap, six would have passed after the last pass.
bool PoseSearch::clearly_slides(const Pose& pose, Judgement& judged) const {
  constexpr double kPart = 0.9, kTimes = 2.0;
  const double min_overlap = kPart * options_.tests.min_overlap;
  if (pose.figures.overlap >= min_overlap * pose.figures.expected_overlap ||
      !may_pass(pose.figures, 1.0, 0.0, least_)) {
    return false;
  }
  double sigma_m = 0.0;
  for (const UndecidedAxis& axis :
       undecided_axes(source_, static_cast<std::size_t>(options_.score_points), target_, pose.T_target_source,
                      pose.figures, options_.free_share, options_.tests)) {
    sigma_m = std::max(sigma_m, axis.sigma_m);
  }
  if (sigma_m < kTimes * kSlidingM) return false;
  ClosureTestOptions tests = options_.tests;
  tests.measured_points = kSettlingPoints;
  judged.figures = figures_of(pose.T_target_source, tests);  // `pose.figures` ignore points farther away
  judge_alignment(judged.result, pose.T_target_source.inverse(), judged.figures, /*converged=*/true,
                  task_.guess_from_to, least_);
  if (!judged.result.verified()) return false;
  const bool refused = refuse_if_sliding(judged, min_overlap, sigma_m, kTimes * kSlidingM);
  judged.result.closure.reset();
  return refused;
}

void PoseSearch::refuse_if_ambiguous(Pose& best, Judgement& found) {
  std::vector<Vector6d> offsets;  // to the poses that fit as well
  for (Pose& other : poses_) {
    if (!differs(other, found) || fit_of(other) < fit_of(best) - options_.ambiguous_margin) continue;
    if (nearly_overlaps(other.figures, found.figures, favours(other, found), options_.tests) &&
        differs(other, found))
      offsets.push_back(found.offset_to(other.T_target_source));  // fit_of() has refined the pose
  }
  sort_falling(offsets, [](const Vector6d& offset) { return -offset.head<3>().norm(); });
  for (const Vector6d& offset : offsets) {
    // The axis of a free direction is known only to about a degree, so the covariance is widened to contain
    // the pose.
    Matrix6d& covariance = found.result.closure->covariance;
    if (along_free_direction(offset, covariance)) {
      covariance += offset * offset.transpose();
      covariance = (0.5 * (covariance + covariance.transpose())).eval();
      continue;
    }
    found.result.closure.reset();
    found.result.reason = RejectionReason::kAmbiguous;
    found.result.message = "another pose, " + std::to_string(offset.head<3>().norm()) + " m and " +
                           std::to_string(offset.tail<3>().norm() / kDegree) + " degrees away, fits as well";
    return;
  }
}

}  // namespace loopwise
