// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/fast_registrar.hpp>

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>
#include "consensus.hpp"
#include "fpfh.hpp"
#include "gicp.hpp"
#include "matching.hpp"
#include "normal_bins.hpp"
#include "pose_scores.hpp"
#include "rivals.hpp"
#include "side.hpp"
#include "sort_falling.hpp"

namespace loopwise {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180.0;
constexpr std::size_t kFewKeys = 200;  // of a scan, whatever the share

/// Key points of one side in the centre's frame.
struct KeyPoints {
  std::vector<Eigen::Vector3f> points;
  std::vector<Eigen::Vector3f> normals;
  PackedDescriptors descriptors;
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + (points.capacity() + normals.capacity()) * sizeof(Eigen::Vector3f) +
           descriptors.bytes();
  }
};

/// Names a submap: equal for equal members in the same places alone.
std::string signature(const std::vector<SubmapMember>& members, std::size_t enough_points) {
  std::string out(reinterpret_cast<const char*>(&enough_points), sizeof enough_points);
  for (const SubmapMember& member : members) {
    out.append(reinterpret_cast<const char*>(&member.key), sizeof member.key);
    out.append(reinterpret_cast<const char*>(member.T_center_member.data()), 16 * sizeof(double));
  }
  return out;
}

/// Key points of one scan in its own frame; the same for every submap that it is part of.
struct ScanKeyPoints {
  std::vector<std::uint32_t> indices;  // into the scan's cloud
  Descriptors descriptors;             // a column each
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + indices.capacity() * sizeof(std::uint32_t) +
           static_cast<std::size_t>(descriptors.size()) * sizeof(float);
  }
};

/// Points that have a descriptor, among those drawn.
ScanKeyPoints describe(const ScanFeatures& scan, const FastRegistrarOptions& options) {
  const auto share = static_cast<std::size_t>(options.key_share * static_cast<double>(scan.cloud.size()));
  const auto drawn = draw_balanced(
      scan.cloud, std::min(static_cast<std::size_t>(options.key_points), std::max(share, kFewKeys)));
  ScanKeyPoints keys;
  keys.descriptors = compute_fpfh(scan.cloud, scan.tree, drawn, options.fpfh_radius_m,
                                  static_cast<std::size_t>(options.fpfh_neighbours));
  Eigen::Index kept = 0;
  for (Eigen::Index i = 0; i < keys.descriptors.cols(); ++i) {
    if (keys.descriptors.col(i).isZero()) continue;
    keys.descriptors.col(kept++) = keys.descriptors.col(i);
    keys.indices.push_back(drawn[static_cast<std::size_t>(i)]);
  }
  keys.descriptors.conservativeResize(kFpfhSize, kept);
  return keys;
}

/// The matches that describe each other best: first those that are mutual, then the others, most similar
/// first.
std::vector<Match> match(const KeyPoints& source, const KeyPoints& target, std::size_t max_matches) {
  std::vector<DescriptorMatch> found = match_descriptors(source.descriptors, target.descriptors);
  std::stable_sort(found.begin(), found.end(), [](const DescriptorMatch& a, const DescriptorMatch& b) {
    return a.mutual != b.mutual ? a.mutual : a.similarity > b.similarity;
  });
  if (found.size() > max_matches) found.resize(max_matches);
  std::vector<Match> matches;
  matches.reserve(found.size());
  for (const DescriptorMatch& m : found) {
    matches.push_back({source.points[m.source], target.points[m.target], source.normals[m.source],
                       target.normals[m.target]});
  }
  return matches;
}

/// Drops matches that no allowed pose explains: one moves a point no further from where the guess has it than
/// the bound on the translation and the arc of the bound on the rotation, and turns no normal further.
void drop_impossible(std::vector<Match>& matches, const Eigen::Isometry3d& guess_target_source,
                     const FastRegistrarOptions& options) {
  constexpr double kNormalNoise = 20.0 * kDegree;
  const double turn = std::min(kPi, options.tests.max_rotation_rad);
  const auto least_cosine = static_cast<float>(std::cos(std::min(kPi, turn + kNormalNoise)));
  const auto arc = static_cast<float>(2.0 * std::sin(0.5 * turn));
  const auto slack = static_cast<float>(options.tests.max_translation_m + options.coarse_reach_m);
  const Eigen::Isometry3f T = guess_target_source.cast<float>();
  const auto impossible = [&](const Match& m) {
    return (T.linear() * m.source_normal).dot(m.target_normal) < least_cosine ||
           (T * m.source - m.target).norm() > slack + arc * m.source.norm();
  };
  matches.erase(std::remove_if(matches.begin(), matches.end(), impossible), matches.end());
}

/// Whether two poses of a cloud about `centre` are different answers, not one answer twice.
bool far_apart(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, const Eigen::Vector3d& centre) {
  return (a * centre - b * centre).norm() > 1.0 || se3::rotation_angle(a.inverse() * b) > 5.0 * kDegree;
}

struct Scored {
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  double value = 0.0;
  std::optional<double> fit;  // see PoseSearch::fit_of
};

/// Poses of one pair that are refined, compared and judged.
class PoseSearch {
  // Scans from two places of a periodic hall share less at the true pose than at one that lays the two
  // sensors over each other: surfaces that one of them does not see count against a pose by little.
  static constexpr double kShareWeight = 0.1;
  static constexpr double kComparableShare = 0.45;
  static constexpr std::size_t kScoredRivals = 16, kRefinedRivals = 4;

 public:
  PoseSearch(const Side& source, const Side& target, const RegistrationTask& task,
             const FastRegistrarOptions& options, RegistrationResult& result)
      : source_(source),
        target_(target),
        task_(task),
        options_(options),
        result_(result),
        passes_(gicp_passes(options.coarse_reach_m, options.fine_reach_m,
                            static_cast<std::size_t>(options.coarse_points),
                            static_cast<std::size_t>(options.fine_points))) {
    fine_pass_ = {passes_.back()};
    passes_.pop_back();
  }

  /// What the last test would refuse need not be tried; the refinement moves a start by its reach at most.
  [[nodiscard]] bool allowed(const Eigen::Isometry3d& T_target_source) const {
    if (!task_.guess_from_to) return true;
    const Eigen::Isometry3d moved = *task_.guess_from_to * T_target_source;
    return moved.translation().norm() <= options_.tests.max_translation_m + options_.coarse_reach_m &&
           se3::rotation_angle(moved) <= options_.tests.max_rotation_rad + 5.0 * kDegree;
  }

  [[nodiscard]] bool empty() const { return refined_.empty(); }

  /// Refines a start from coarse to fine and keeps it. Returns its share on the target's surfaces, against
  /// what is expected of a right one; 0 if it went where it is not allowed.
  double refine(const Eigen::Isometry3d& start) {
    const Stopwatch watch;
    Scored pose;
    pose.T_target_source = gicp(start, passes_).T_target_source;
    if (pose.T_target_source.matrix().allFinite() && allowed(pose.T_target_source)) {
      pose.value = share_of(pose.T_target_source);
      const auto worse = [&](const Scored& other) { return other.value < pose.value; };
      refined_.insert(std::find_if(refined_.begin(), refined_.end(), worse), pose);
    }
    result_.refine_s += watch.seconds();
    return pose.value;
  }

  /// Judges the best pose. One that passes is compared with its rivals.
  void decide() {
    const Stopwatch watch;
    Scored best = best_in_detail();
    judge(best.T_target_source);
    if (result_.verified()) {
      add_rivals(best.T_target_source);
      const Scored better = best_in_detail();
      if (!better.T_target_source.isApprox(best.T_target_source, 0.0)) {
        best = better;
        judge(best.T_target_source);
      }
    }
    if (result_.verified()) refuse_if_ambiguous(best);
    result_.refine_s += watch.seconds();
  }

 private:
  [[nodiscard]] double expected_on_plane() const {
    return 0.5 * (source_.share.on_plane + target_.share.on_plane);
  }
  [[nodiscard]] std::size_t scored_points() const { return static_cast<std::size_t>(options_.score_points); }
  [[nodiscard]] double share_of(const Eigen::Isometry3d& T_target_source) const {
    return share_on_surface(source_, scored_points(), target_, T_target_source, options_.tests) /
           (expected_on_plane() * target_.share.overlap);
  }
  [[nodiscard]] GicpResult gicp(const Eigen::Isometry3d& start, const std::vector<GicpPass>& passes) const {
    return refine_gicp(source_.submap.cloud(), source_.order, target_.submap.cloud(), target_.submap.tree(),
                       start, passes);
  }

  [[nodiscard]] AlignmentFigures figures_of(const Eigen::Isometry3d& T_target_source,
                                            int measured_points) const {
    const PointCloud& cloud = source_.submap.cloud();
    ClosureTestOptions tests = options_.tests;
    tests.measured_points = measured_points;
    AlignmentFigures figures =
        measure_alignment(cloud, target_.submap.cloud(), target_.submap.tree(), T_target_source, tests);
    figures.expected_on_plane = expected_on_plane();
    // Sparse scans of long range: fewer than half of the points have a neighbour.
    figures.expected_overlap = std::min(1.0, 2.0 * target_.share.overlap);
    constexpr std::size_t kLookedAt = 1000;
    figures.contradiction = target_.range_image.contradiction(cloud, T_target_source, kLookedAt) +
                            source_.range_image.contradiction(target_.submap.parts().front().features->cloud,
                                                              T_target_source.inverse(), kLookedAt);
    return figures;
  }

  /// Settles a pose and fills the result from it.
  void judge(const Eigen::Isometry3d& T_target_source) {
    result_.closure.reset();
    const GicpResult final = gicp(T_target_source, fine_pass_);
    const AlignmentFigures figures = figures_of(final.T_target_source, options_.tests.measured_points);
    judge_alignment(result_, final.T_target_source.inverse(), figures, final.converged, task_.guess_from_to,
                    options_.tests);
    if (!result_.verified()) return;
    widen_undecided(source_, scored_points(), target_, final.T_target_source, figures, options_.free_share,
                    options_.tests, result_.closure->covariance);
  }

  /// How well a pose fits, for the comparison of poses: consistency + ln(share on surfaces) / 10. Settles the
  /// pose first: coarse passes may leave a degree.
  [[nodiscard]] double fit_of(Scored& pose) const {
    if (!pose.fit) {
      constexpr int kMeasured = 600;
      const std::vector<GicpPass> settle{{options_.fine_reach_m, kMeasured, 10, 2e-3, 2e-4}};
      pose.T_target_source = gicp(pose.T_target_source, settle).T_target_source;
      pose.fit = consistency(figures_of(pose.T_target_source, kMeasured)) +
                 kShareWeight * std::log(std::max(1e-6, share_of(pose.T_target_source)));
    }
    return *pose.fit;
  }

  /// The pose that fits best among those whose share comes near the largest.
  [[nodiscard]] Scored best_in_detail() {
    Scored* best = &refined_.front();
    for (Scored& other : refined_) {
      if (other.value < kComparableShare * refined_.front().value) break;
      if (!far_apart(other.T_target_source, best->T_target_source, source_.centre)) continue;
      if (fit_of(other) > fit_of(*best)) best = &other;
    }
    return *best;
  }

  /// Refines the rivals of a pose that come nearest to the target.
  void add_rivals(const Eigen::Isometry3d& best) {
    const auto near = [&](const Eigen::Isometry3d& T) {
      return near_share(source_, scored_points() / 4, target_, T,
                        static_cast<float>(options_.coarse_reach_m));
    };
    std::vector<Scored> rivals;
    double max_turn_rad = kPi;
    if (task_.guess_from_to) {
      max_turn_rad = options_.tests.max_rotation_rad + se3::rotation_angle(*task_.guess_from_to * best);
    }
    for (const Eigen::Isometry3d& rival : find_rivals(source_, target_, best, max_turn_rad)) {
      if (rivals.size() == kScoredRivals) break;
      if (allowed(rival)) rivals.push_back({rival, near(rival), {}});
    }
    sort_falling(rivals, [](const Scored& rival) { return rival.value; });
    // Most slide back to the pose itself, which few points show.
    std::vector<GicpPass> quick = passes_;
    const std::size_t few = scored_points() / 3;
    for (GicpPass& pass : quick) pass.points = std::min(pass.points, few);
    const auto quick_share = [&](const Eigen::Isometry3d& T) {
      return share_on_surface(source_, few, target_, T, options_.tests);
    };
    const double least_near = kComparableShare * near(best),
                 least_share = kComparableShare * quick_share(best);
    for (std::size_t i = 0; i < std::min(rivals.size(), kRefinedRivals) && rivals[i].value >= least_near;
         ++i) {
      const Eigen::Isometry3d rival = gicp(rivals[i].T_target_source, quick).T_target_source;
      if (!rival.matrix().allFinite() || !far_apart(rival, best, source_.centre)) continue;
      if (quick_share(rival) >= least_share) refine(rival);
    }
  }

  /// From the closure to another pose, as its covariance has it.
  [[nodiscard]] Vector6d offset_to(const Eigen::Isometry3d& T_target_source) const {
    return se3::log(result_.closure->T_from_to.inverse() * T_target_source.inverse());
  }

  /// Whether a pose lies beyond the 0.999 quantile of the closure's χ² of six.
  [[nodiscard]] bool excluded(const Vector6d& offset) const {
    constexpr double kChiSquare = 22.46;
    return offset.dot(result_.closure->covariance.ldlt().solve(offset)) > kChiSquare;
  }

  /// Whether the closure says little about the direction of an offset: it is within eight deviations there.
  /// Periods are a hundred away.
  [[nodiscard]] bool along_free_direction(const Vector6d& offset) const {
    const auto within = [&](Eigen::Index part) {
      const Eigen::Vector3d d = offset.segment<3>(part);
      const Eigen::Matrix3d C = result_.closure->covariance.block<3, 3>(part, part);
      return d.squaredNorm() * d.squaredNorm() <= 64.0 * d.dot(C * d);
    };
    return within(0) && within(3);
  }

  void refuse_if_ambiguous(Scored best) {
    const Eigen::Isometry3d found = result_.closure->T_from_to.inverse();
    for (Scored& other : refined_) {
      if (other.value < kComparableShare * best.value) break;
      if (!far_apart(other.T_target_source, found, source_.centre)) continue;
      if (!excluded(offset_to(other.T_target_source))) continue;
      if (fit_of(other) < fit_of(best) - options_.ambiguous_margin) continue;
      const Vector6d offset = offset_to(other.T_target_source);  // it has settled
      if (along_free_direction(offset)) {
        // The axis of a free direction is known to a degree or so: the covariance takes in the pose.
        Matrix6d& covariance = result_.closure->covariance;
        covariance += offset * offset.transpose();
        covariance = (0.5 * (covariance + covariance.transpose())).eval();
        continue;
      }
      result_.closure.reset();
      result_.reason = RejectionReason::kAmbiguous;
      result_.message = "another pose, " + std::to_string(offset.head<3>().norm()) + " m and " +
                        std::to_string(offset.tail<3>().norm() / kDegree) + " degrees away, fits as well";
      return;
    }
  }

  const Side& source_;
  const Side& target_;
  const RegistrationTask& task_;
  const FastRegistrarOptions& options_;
  RegistrationResult& result_;
  std::vector<GicpPass> passes_, fine_pass_;
  std::vector<Scored> refined_;  // best first
};

}  // namespace

struct FastRegistrar::Impl {
  std::shared_ptr<FeatureCache> features;
  FastRegistrarOptions options;
  mutable BoundedCache<std::string, Side> sides;
  mutable BoundedCache<std::string, KeyPoints> keys;
  mutable BoundedCache<Key, ScanKeyPoints> scan_keys;

  /// Null if a scan is missing: then `result` says which.
  [[nodiscard]] std::shared_ptr<const Side> side(const std::string& name,
                                                 const std::vector<SubmapMember>& members,
                                                 std::size_t enough_points,
                                                 RegistrationResult& result) const {
    return sides.get(name, [&](const std::string&) -> std::shared_ptr<const Side> {
      std::optional<Submap> submap = Submap::load(*features, members, enough_points, result);
      if (!submap) return nullptr;
      auto out = std::make_shared<Side>();
      out->submap = std::move(*submap);
      out->order = draw_balanced(
          out->submap.cloud(), static_cast<std::size_t>(std::max(options.fine_points, options.score_points)));
      out->range_image = RangeImage(out->submap.parts().front().features->cloud);
      out->centre = robust_centre(out->submap.cloud().points);
      out->share = surface_share(out->submap.cloud(), out->submap.tree(), options.tests);
      return out;
    });
  }

  [[nodiscard]] std::shared_ptr<const KeyPoints> key_points(const std::string& name, const Side& side) const {
    return keys.get(name, [&](const std::string&) {
      auto out = std::make_shared<KeyPoints>();
      std::vector<std::shared_ptr<const ScanKeyPoints>> parts;
      Eigen::Index count = 0;
      for (const Part& part : side.submap.parts()) {
        const PointCloud& cloud = part.features->cloud;
        parts.push_back(scan_keys.get(part.key, [&](Key) {
          return std::make_shared<ScanKeyPoints>(describe(*part.features, options));
        }));
        count += parts.back()->descriptors.cols();
        const Eigen::Matrix3f R = part.T_center_part.linear().cast<float>();
        for (const std::uint32_t i : parts.back()->indices) {
          out->points.push_back((part.T_center_part * cloud.points[i].cast<double>()).cast<float>());
          out->normals.push_back(R * cloud.normals[i]);
        }
      }
      Descriptors all(kFpfhSize, count);
      Eigen::Index begin = 0;
      for (const auto& part : parts) {
        all.middleCols(begin, part->descriptors.cols()) = part->descriptors;
        begin += part->descriptors.cols();
      }
      out->descriptors = PackedDescriptors(all);
      return out;
    });
  }
};

FastRegistrar::FastRegistrar(std::shared_ptr<FeatureCache> features, const FastRegistrarOptions& options) {
  validate(options);
  if (!features) throw InputError("a registrar needs a feature cache");
  const auto bytes = static_cast<std::size_t>(options.max_descriptor_mb * 1e6);
  // NOLINTNEXTLINE(modernize-make-unique): an aggregate
  impl_.reset(new Impl{std::move(features), options, BoundedCache<std::string, Side>(bytes),
                       BoundedCache<std::string, KeyPoints>(bytes), BoundedCache<Key, ScanKeyPoints>(bytes)});
}

FastRegistrar::~FastRegistrar() = default;

void FastRegistrar::prepare(Key key) const {
  const std::vector<SubmapMember> members{{key, Eigen::Isometry3d::Identity()}};
  const std::string name = signature(members, 0);
  RegistrationResult ignored;
  if (const auto side = impl_->side(name, members, 0, ignored)) {
    static_cast<void>(impl_->key_points(name, *side));
  }
}

namespace {

/// Of its key points: what lacks a member is another side.
std::string name_of(const Side& side, const std::string& whole) {
  if (!side.submap.incomplete()) return whole;
  std::vector<SubmapMember> members;
  for (const Part& part : side.submap.parts()) members.push_back({part.key, part.T_center_part});
  return signature(members, 0) + "of what is there";
}

}  // namespace

RegistrationResult FastRegistrar::compute(const RegistrationTask& task) const {
  const FastRegistrarOptions& options = impl_->options;
  RegistrationResult result;
  result.candidate = task.candidate;
  const auto reject = [&](RejectionReason reason, std::string message) {
    result.reason = reason;
    result.message = std::move(message);
    return result;
  };
  const Deadline deadline(task.time_limit_s);
  const auto late = [&] {
    return reject(RejectionReason::kTimeLimit, "not done after " + std::to_string(task.time_limit_s) + " s");
  };
  Stopwatch features_watch;
  const std::string source_name = signature(task.source, task.enough_points);
  const std::string target_name = signature(task.target, task.enough_points);
  const auto source_side = impl_->side(source_name, task.source, task.enough_points, result);
  if (!source_side) return result;
  if (deadline.passed()) return late();
  const auto target_side = impl_->side(target_name, task.target, task.enough_points, result);
  if (!target_side) return result;
  result.incomplete = source_side->submap.incomplete() || target_side->submap.incomplete();
  // cppcheck-suppress identicalConditionAfterEarlyExit ; time has passed since
  if (deadline.passed()) return late();
  const Side& source = *source_side;
  const Side& target = *target_side;
  const PointCloud& source_cloud = source.submap.cloud();
  const PointCloud& target_cloud = target.submap.cloud();
  const std::size_t fewest = std::min(source_cloud.size(), target_cloud.size());
  if (fewest < static_cast<std::size_t>(options.tests.min_points)) {
    return reject(RejectionReason::kTooFewPoints,
                  std::to_string(fewest) + " points, must be >= " + std::to_string(options.tests.min_points));
  }
  if (source.order.size() < static_cast<std::size_t>(options.tests.min_points)) {
    return reject(RejectionReason::kTooFewPoints,
                  std::to_string(source.order.size()) +
                      " points with a normal, must be >= " + std::to_string(options.tests.min_points));
  }
  result.features_s = features_watch.seconds();

  PoseSearch search(source, target, task, options, result);
  const auto scored_points = static_cast<std::size_t>(options.score_points);
  const auto reach = static_cast<float>(options.coarse_reach_m);
  if (task.guess_from_to) {
    const Stopwatch watch;
    const Eigen::Isometry3d guess = task.guess_from_to->inverse();
    const bool promising = near_share(source, scored_points, target, guess, reach) >= options.min_score;
    result.global_s += watch.seconds();
    if (promising && search.refine(guess) >= options.sure_share) {
      search.decide();
      if (result.verified() || result.reason == RejectionReason::kAmbiguous) return result;
    }
  }
  if (deadline.passed()) return late();
  Stopwatch keys_watch;
  const auto source_keys = impl_->key_points(name_of(source, source_name), source);
  const auto target_keys = impl_->key_points(name_of(target, target_name), target);
  result.features_s += keys_watch.seconds();
  if (deadline.passed()) return late();
  const Stopwatch global_watch;
  if (std::min(source_keys->points.size(), target_keys->points.size()) < 3) {
    return reject(RejectionReason::kTooFewPoints, "fewer than 3 key points with a normal and neighbours");
  }
  std::vector<Match> matches =
      match(*source_keys, *target_keys, static_cast<std::size_t>(options.max_matches));
  if (task.guess_from_to) drop_impossible(matches, task.guess_from_to->inverse(), options);
  if (deadline.passed()) return late();
  const Consensus consensus =
      find_consensus(matches, options.match_tolerance_m, static_cast<std::size_t>(options.hypotheses),
                     [&](const Eigen::Isometry3d& T) { return search.allowed(T); });
  // A quarter of the points tells which hypotheses are worth all of them.
  std::vector<Scored> scored;
  double most = 0.0;
  for (const Hypothesis& h : consensus.hypotheses) {
    if (deadline.passed()) return late();
    scored.push_back(
        {h.T_target_source, near_share(source, scored_points / 4, target, h.T_target_source, reach), {}});
    most = std::max(most, scored.back().value);
  }
  for (Scored& s : scored) {
    s.value =
        s.value < 0.6 * most ? 0.0 : near_share(source, scored_points, target, s.T_target_source, reach);
  }
  sort_falling(scored, [](const Scored& s) { return s.value; });
  result.global_s += global_watch.seconds();
  if (!scored.empty()) result.T_from_to = scored.front().T_target_source.inverse();
  std::vector<Eigen::Isometry3d> starts;
  for (const Scored& s : scored) {
    if (s.value < options.min_score || s.value < 0.75 * scored.front().value ||
        starts.size() == static_cast<std::size_t>(options.refined_hypotheses)) {
      break;
    }
    const auto near = [&](const Eigen::Isometry3d& other) {
      return !far_apart(other, s.T_target_source, source.centre);
    };
    if (std::any_of(starts.begin(), starts.end(), near)) continue;
    if (deadline.passed()) return late();
    starts.push_back(s.T_target_source);
    search.refine(s.T_target_source);
  }
  if (search.empty()) {
    if (consensus.hypotheses.empty() && consensus.refused == 0) {
      return reject(RejectionReason::kFewMatches,
                    "no three of " + std::to_string(matches.size()) + " matches agree on a pose");
    }
    if (scored.empty()) {
      return reject(
          RejectionReason::kTransformThreshold,
          "all of " + std::to_string(consensus.refused) + " hypotheses are too far from the graph's pose");
    }
    return reject(RejectionReason::kLowOverlap, "the best of " + std::to_string(scored.size()) +
                                                    " hypotheses scores " +
                                                    std::to_string(scored.front().value) +
                                                    ", must be >= " + std::to_string(options.min_score));
  }
  if (deadline.passed()) return late();
  search.decide();
  return result;
}

}  // namespace loopwise
