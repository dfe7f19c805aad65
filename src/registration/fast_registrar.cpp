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
#include "../core/constants.hpp"
#include "consensus.hpp"
#include "fpfh.hpp"
#include "guess_region.hpp"
#include "matching.hpp"
#include "normal_bins.hpp"
#include "pose_scores.hpp"
#include "pose_search.hpp"
#include "rivals.hpp"
#include "side.hpp"
#include "sort_falling.hpp"
#include "surface.hpp"

namespace loopwise {
namespace {

constexpr std::size_t kFewKeys = 200;  // of a scan at least, for any share
// Votes of each turn that become poses, and poses that are compared on the scans. Votes favour poses that put
// the dense surfaces near both sensors on top of each other: in a tunnel, the true pose may have few.
constexpr std::size_t kVotesOfTurn = 24, kFirstVotes = 8, kComparedVotes = 60;
// The errors of voted poses of up to half a cell leave fewer points near the target than a refined pose has:
// this part of min_score suffices. Points in the other scan's free space have the weight that consistency()
// gives them where half of the points overlap.
constexpr double kVotedScorePart = 2.0 / 3.0, kFreeWeight = 5.0;
constexpr std::size_t kFreePoints = 100;
// Votes cover this distance about a guess. Within wider bounds, matches of descriptors follow.
constexpr double kVotedReachM = 24.0;

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

/// Name of a submap. Two submaps have the same name only if they have the same members at the same poses.
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

/// Describes the drawn points. Points without a descriptor are left out.
ScanKeyPoints describe(const ScanFeatures& scan, const FastRegistrarOptions& options) {
  const auto share = static_cast<std::size_t>(options.key_share * static_cast<double>(scan.cloud.size()));
  const auto drawn = draw_balanced(
      scan.cloud, std::min(static_cast<std::size_t>(options.key_points), std::max(share, kFewKeys)));
  ScanKeyPoints keys;
  keys.descriptors = compute_fpfh(surface_of(scan.cloud), scan.tree, drawn, options.fpfh_radius_m,
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

/// Matches of similar descriptors, best first.
std::vector<Match> match(const KeyPoints& source, const KeyPoints& target, std::size_t max_matches) {
  std::vector<Match> matches;
  for (const DescriptorMatch& m :
       best_matches(most_similar(target.descriptors, source.descriptors), max_matches)) {
    matches.push_back({source.points[m.source], target.points[m.target], source.normals[m.source],
                       target.normals[m.target]});
  }
  return matches;
}

/// Drops matches that no allowed pose explains. From its position at the guess, an allowed pose moves a point
/// by at most the bound on the translation plus the arc of the bound on the rotation about the target's
/// origin. It turns a normal by at most the bound on the rotation.
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
           (T * m.source - m.target).norm() > slack + arc * (T * m.source).norm();
  };
  matches.erase(std::remove_if(matches.begin(), matches.end(), impossible), matches.end());
}

}  // namespace

struct FastRegistrar::Impl {
  class Pair;

  std::shared_ptr<FeatureCache> features;
  FastRegistrarOptions options;
  mutable BoundedCache<std::string, Side> sides;
  mutable BoundedCache<std::string, KeyPoints> keys;
  mutable BoundedCache<Key, ScanKeyPoints> scan_keys;

  /// Null if a scan is missing; `result` then names the scan.
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

/// Name of a side's key points. A side without some members has a different name.
std::string name_of(const Side& side, const std::string& whole) {
  if (!side.submap.incomplete()) return whole;
  std::vector<SubmapMember> members;
  for (const Part& part : side.submap.parts()) members.push_back({part.key, part.T_center_part});
  return signature(members, 0) + "of what is there";
}

/// Adds the wall time of a scope to a sum.
class ScopeTimer {
 public:
  explicit ScopeTimer(double& sum_s) : sum_s_(sum_s) {}
  ScopeTimer(const ScopeTimer&) = delete;
  ScopeTimer& operator=(const ScopeTimer&) = delete;
  ~ScopeTimer() { sum_s_ += watch_.seconds(); }

 private:
  double& sum_s_;
  Stopwatch watch_;
};

/// A pose and how promising it is.
struct Scored {
  Eigen::Isometry3d T_target_source;
  double value;
};

}  // namespace

/// The registration of one pair. A stage returns whether the next one follows; if not, the result is final.
class FastRegistrar::Impl::Pair {
 public:
  Pair(const Impl& impl, const RegistrationTask& task)
      : impl_(impl),
        options_(impl.options),
        task_(task),
        region_(task, impl.options),
        deadline_(task.time_limit_s) {
    result_.candidate = task.candidate;
  }

  [[nodiscard]] RegistrationResult run() {
    if (load_sides() && has_enough_points()) {
      PoseSearch search(*source_, *target_, task_, options_, result_);
      // Votes cost less, but are reliable only about a guess.
      if (!task_.guess_from_to) {
        if (search_by_descriptors(search)) search_by_votes(search);
      } else if (try_guess(search) && search_by_votes_about_guess(search)) {
        search_further(search);
      }
    }
    return std::move(result_);
  }

 private:
  bool reject(RejectionReason reason, std::string message) {
    result_.closure.reset();
    result_.reason = reason;
    result_.message = std::move(message);
    return false;
  }

  bool in_time() { return !deadline_.passed() || reject_late(); }
  bool reject_late() {
    return reject(RejectionReason::kTimeLimit, "not done after " + std::to_string(task_.time_limit_s) + " s");
  }

  [[nodiscard]] double near(const Eigen::Isometry3d& T_target_source, std::size_t points) const {
    return near_share(*source_, points, *target_, T_target_source,
                      static_cast<float>(options_.coarse_reach_m));
  }

  [[nodiscard]] double near_by_few(const Eigen::Isometry3d& voted) const {
    return near(voted, static_cast<std::size_t>(std::max(options_.score_points / 4, 1)));
  }
  [[nodiscard]] bool has_voted_share(double share) const {
    return share >= kVotedScorePart * options_.min_score;
  }

  bool load_sides();
  bool has_enough_points();
  bool try_guess(PoseSearch& search);
  bool settle(PoseSearch& search);
  std::vector<Eigen::Isometry3d> find_votes(const PoseSearch& search);
  bool refine_votes(const std::vector<Eigen::Isometry3d>& voted, PoseSearch& search);
  bool refine_in_free_space(const std::vector<Eigen::Isometry3d>& voted, std::size_t begin,
                            PoseSearch& search);
  bool search_by_votes(PoseSearch& search);
  bool search_by_votes_about_guess(PoseSearch& search);
  void search_further(PoseSearch& search);
  bool search_by_descriptors(PoseSearch& search);
  bool find_matches(const PoseSearch& search, std::vector<Match>& matches);
  bool score(const Consensus& consensus, std::vector<Scored>& scored);
  bool refine_best(const std::vector<Scored>& scored, PoseSearch& search);
  bool reject_without_pose(std::size_t matches, const Consensus& consensus,
                           const std::vector<Scored>& scored);

  const Impl& impl_;
  const FastRegistrarOptions& options_;
  const RegistrationTask& task_;
  const GuessRegion region_;
  Deadline deadline_;
  RegistrationResult result_;
  std::string source_name_, target_name_;
  std::shared_ptr<const Side> source_, target_;
};

bool FastRegistrar::Impl::Pair::load_sides() {
  const ScopeTimer timer(result_.features_s);
  source_name_ = signature(task_.source, task_.enough_points);
  target_name_ = signature(task_.target, task_.enough_points);
  source_ = impl_.side(source_name_, task_.source, task_.enough_points, result_);
  if (!source_ || !in_time()) return false;
  target_ = impl_.side(target_name_, task_.target, task_.enough_points, result_);
  if (!target_) return false;
  result_.incomplete = source_->submap.incomplete() || target_->submap.incomplete();
  return in_time();
}

bool FastRegistrar::Impl::Pair::has_enough_points() {
  const auto least = static_cast<std::size_t>(options_.tests.min_points);
  const auto require = [&](std::size_t points, const char* kind) {
    return points >= least || reject(RejectionReason::kTooFewPoints,
                                     std::to_string(points) + kind + ", must be >= " + std::to_string(least));
  };
  return require(std::min(source_->submap.cloud().size(), target_->submap.cloud().size()), " points") &&
         require(source_->order.size(), " points with a normal");
}

/// Refines the graph's pose and tests it, if the scans are near each other there.
bool FastRegistrar::Impl::Pair::try_guess(PoseSearch& search) {
  if (!task_.guess_from_to) return in_time();
  // Below this, so few points are near the target that the refinement cannot start.
  constexpr double kHopeless = 0.2;
  const Eigen::Isometry3d guess = task_.guess_from_to->inverse();
  double score = 0.0;
  {
    const ScopeTimer timer(result_.global_s);
    score = near(guess, static_cast<std::size_t>(options_.score_points));
  }
  const ScopeTimer timer(result_.refine_s);
  if (score < kHopeless * options_.min_score) return in_time();
  const bool sure = search.refine(guess) >= options_.sure_share && score >= options_.min_score;
  return !sure || settle(search);
}

/// Tests the poses so far. \returns whether a further search is needed: no pose passes the tests in detail,
/// and there is time
bool FastRegistrar::Impl::Pair::settle(PoseSearch& search) {
  if (search.empty()) return in_time();
  if (!search.decide(deadline_)) return reject_late();
  // A degenerate pose has passed the tests in detail, so the scans are where they belong.
  const bool found = result_.verified() || result_.reason == RejectionReason::kAmbiguous ||
                     result_.reason == RejectionReason::kDegenerate;
  return !found && in_time();
}

/// Poses for which many pairs of parallel surfaces vote, among those that the guess allows, most votes first.
std::vector<Eigen::Isometry3d> FastRegistrar::Impl::Pair::find_votes(const PoseSearch& search) {
  const ScopeTimer timer(result_.global_s);
  Eigen::Isometry3d about = Eigen::Isometry3d::Identity();
  about.translation() = target_->centre - source_->centre;
  if (task_.guess_from_to) about = task_.guess_from_to->inverse();
  const double max_turn_rad = task_.guess_from_to ? options_.tests.max_rotation_rad : kPi;
  return find_rivals(*source_, *target_, about, max_turn_rad, kVotesOfTurn,
                     [&](const Eigen::Isometry3d& T) { return search.allowed(T) && region_.contains(T); });
}

/// Refines the voted poses with the most votes that have enough points near the target, and tests them. If
/// none passes, others follow. \returns as settle()
bool FastRegistrar::Impl::Pair::refine_votes(const std::vector<Eigen::Isometry3d>& voted,
                                             PoseSearch& search) {
  const ScopeTimer timer(result_.refine_s);
  std::size_t tried = 0;
  int refined = 0;
  for (; tried < std::min(kFirstVotes, voted.size()) && refined < options_.refined_hypotheses; ++tried) {
    if (!in_time()) return false;
    if (!has_voted_share(near_by_few(voted[tried]))) continue;
    search.refine_coarsely(voted[tried]);
    ++refined;
  }
  return settle(search) && refine_in_free_space(voted, tried, search);
}

/// The same with the poses from `begin` on that are the best by their points near the target and in free
/// space. \returns as settle()
bool FastRegistrar::Impl::Pair::refine_in_free_space(const std::vector<Eigen::Isometry3d>& voted,
                                                     std::size_t begin, PoseSearch& search) {
  std::vector<Scored> scored;
  for (std::size_t i = begin; i < std::min(kComparedVotes, voted.size()); ++i) {
    if (!in_time()) return false;
    const double share = near_by_few(voted[i]);
    if (!has_voted_share(share)) continue;
    const double free = contradiction(*source_, *target_, voted[i], kFreePoints);
    if (share > kFreeWeight * free) scored.push_back({voted[i], share - kFreeWeight * free});
  }
  sort_falling(scored, [](const Scored& s) { return s.value; });
  const auto most = std::min(static_cast<std::size_t>(options_.refined_votes), scored.size());
  for (std::size_t i = 0; i < most; ++i) {
    if (!in_time()) return false;
    search.refine_coarsely(scored[i].T_target_source);
  }
  return settle(search);
}

/// Refines poses by votes. Unlike descriptors, votes need no surface that both scans see in detail, so they
/// also find scans that overlap little. \returns as settle()
bool FastRegistrar::Impl::Pair::search_by_votes(PoseSearch& search) {
  return refine_votes(find_votes(search), search);
}

/// Refines poses by votes near the guess, then, if its covariance is known, those in the rest of the region.
/// \returns as settle()
bool FastRegistrar::Impl::Pair::search_by_votes_about_guess(PoseSearch& search) {
  std::vector<Eigen::Isometry3d> near_guess, far_off;
  for (const Eigen::Isometry3d& T : find_votes(search)) {
    (region_.is_near(T) ? near_guess : far_off).push_back(T);
  }
  return refine_votes(near_guess, search) && (!region_.is_known() || refine_votes(far_off, search));
}

/// Searches by descriptors unless votes have covered all that the guess allows.
void FastRegistrar::Impl::Pair::search_further(PoseSearch& search) {
  if (!region_.is_known() || options_.tests.max_translation_m > kVotedReachM) {
    search_by_descriptors(search);
  } else if (result_.reason == RejectionReason::kNone) {  // no pose was tested
    reject(RejectionReason::kLowOverlap,
           "no pose within guess_sigmas of the guess has enough points near the target");
  }
}

/// Matches of descriptors that some allowed pose explains.
bool FastRegistrar::Impl::Pair::find_matches(const PoseSearch& search, std::vector<Match>& matches) {
  std::shared_ptr<const KeyPoints> source, target;
  {
    const ScopeTimer timer(result_.features_s);
    source = impl_.key_points(name_of(*source_, source_name_), *source_);
    target = impl_.key_points(name_of(*target_, target_name_), *target_);
  }
  if (!in_time()) return false;
  const ScopeTimer timer(result_.global_s);
  if (std::min(source->points.size(), target->points.size()) < 3) {
    if (!search.empty()) return in_time();  // the test of a pose says more
    return reject(RejectionReason::kTooFewPoints, "fewer than 3 key points with a normal and neighbours");
  }
  matches = match(*source, *target, static_cast<std::size_t>(options_.max_matches));
  if (task_.guess_from_to) drop_impossible(matches, task_.guess_from_to->inverse(), options_);
  return in_time();
}

/// Compares the hypotheses on the scans, best first. A quarter of the points suffices to discard poor ones.
bool FastRegistrar::Impl::Pair::score(const Consensus& consensus, std::vector<Scored>& scored) {
  const auto points = static_cast<std::size_t>(options_.score_points);
  double most = 0.0;
  for (const Hypothesis& h : consensus.hypotheses) {
    if (!in_time()) return false;
    scored.push_back({h.T_target_source, near(h.T_target_source, points / 4)});
    most = std::max(most, scored.back().value);
  }
  for (Scored& s : scored) s.value = s.value < 0.6 * most ? 0.0 : near(s.T_target_source, points);
  sort_falling(scored, [](const Scored& s) { return s.value; });
  if (!scored.empty() && !result_.T_from_to) result_.T_from_to = scored.front().T_target_source.inverse();
  return true;
}

/// Refines the best hypotheses that are not the same pose.
bool FastRegistrar::Impl::Pair::refine_best(const std::vector<Scored>& scored, PoseSearch& search) {
  const ScopeTimer timer(result_.refine_s);
  std::vector<Eigen::Isometry3d> starts;
  for (const Scored& s : scored) {
    if (s.value < options_.min_score || s.value < 0.75 * scored.front().value ||
        starts.size() == static_cast<std::size_t>(options_.refined_hypotheses)) {
      break;
    }
    const auto same = [&](const Eigen::Isometry3d& other) {
      return !far_apart(other, s.T_target_source, source_->centre);
    };
    if (std::any_of(starts.begin(), starts.end(), same)) continue;
    if (!in_time()) return false;
    starts.push_back(s.T_target_source);
    search.refine(s.T_target_source);
  }
  return true;
}

bool FastRegistrar::Impl::Pair::reject_without_pose(std::size_t matches, const Consensus& consensus,
                                                    const std::vector<Scored>& scored) {
  if (consensus.hypotheses.empty() && consensus.refused == 0) {
    return reject(RejectionReason::kFewMatches,
                  "no three of " + std::to_string(matches) + " matches agree on a pose");
  }
  if (scored.empty()) {
    return reject(RejectionReason::kTransformThreshold, "all of " + std::to_string(consensus.refused) +
                                                            " hypotheses are too far from the graph's pose");
  }
  return reject(RejectionReason::kLowOverlap, "the best of " + std::to_string(scored.size()) +
                                                  " hypotheses scores " +
                                                  std::to_string(scored.front().value) +
                                                  ", must be >= " + std::to_string(options_.min_score));
}

/// Refines poses from matches of descriptors. \returns as settle()
bool FastRegistrar::Impl::Pair::search_by_descriptors(PoseSearch& search) {
  std::vector<Match> matches;
  if (!find_matches(search, matches)) return false;
  Consensus consensus;
  std::vector<Scored> scored;
  {
    const ScopeTimer timer(result_.global_s);
    consensus =
        find_consensus(matches, options_.match_tolerance_m, static_cast<std::size_t>(options_.hypotheses),
                       [&](const Eigen::Isometry3d& T) { return search.allowed(T) && region_.contains(T); });
    if (!score(consensus, scored)) return false;
  }
  if (!refine_best(scored, search)) return false;
  if (search.empty()) reject_without_pose(matches.size(), consensus, scored);
  const ScopeTimer timer(result_.refine_s);
  return settle(search);
}

RegistrationResult FastRegistrar::compute(const RegistrationTask& task) const {
  return Impl::Pair(*impl_, task).run();
}

}  // namespace loopwise
