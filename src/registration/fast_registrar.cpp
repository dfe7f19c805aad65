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
#include "matching.hpp"
#include "normal_bins.hpp"
#include "pose_scores.hpp"
#include "pose_search.hpp"
#include "side.hpp"
#include "sort_falling.hpp"

namespace loopwise {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180.0;
constexpr std::size_t kFewKeys = 200;  // of a scan at least, for any share

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

/// Matches of similar descriptors: mutual ones first, then the others, each by falling similarity.
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
    result.closure.reset();
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
    const Stopwatch refine_watch;
    if (promising && search.refine(guess) >= options.sure_share && !search.empty()) {
      const bool in_time = search.decide(deadline);
      result.refine_s += refine_watch.seconds();
      if (!in_time) return late();
      if (result.verified() || result.reason == RejectionReason::kAmbiguous) return result;
    } else {
      result.refine_s += refine_watch.seconds();
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
  // A quarter of the points suffices to discard poor hypotheses.
  struct Scored {
    Eigen::Isometry3d T_target_source;
    double value;
  };
  std::vector<Scored> scored;
  double most = 0.0;
  for (const Hypothesis& h : consensus.hypotheses) {
    if (deadline.passed()) return late();
    scored.push_back(
        {h.T_target_source, near_share(source, scored_points / 4, target, h.T_target_source, reach)});
    most = std::max(most, scored.back().value);
  }
  for (Scored& s : scored) {
    s.value =
        s.value < 0.6 * most ? 0.0 : near_share(source, scored_points, target, s.T_target_source, reach);
  }
  sort_falling(scored, [](const Scored& s) { return s.value; });
  result.global_s += global_watch.seconds();
  if (!scored.empty()) result.T_from_to = scored.front().T_target_source.inverse();
  const Stopwatch refine_watch;
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
  result.refine_s += refine_watch.seconds();
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
  const Stopwatch decide_watch;
  const bool in_time = search.decide(deadline);
  result.refine_s += decide_watch.seconds();
  return in_time ? result : late();
}

}  // namespace loopwise
