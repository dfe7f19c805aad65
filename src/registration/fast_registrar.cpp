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
#include "consensus.hpp"
#include "fpfh.hpp"
#include "gicp.hpp"
#include "normal_bins.hpp"
#include "submap.hpp"

namespace loopwise {
namespace {

/// Key points of a scan with descriptors.
struct ScanKeyPoints {
  std::vector<std::uint32_t> indices;  // into the scan's downsampled cloud
  Descriptors descriptors;             // a column each, none of them zero
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + indices.capacity() * sizeof(std::uint32_t) +
           static_cast<std::size_t>(descriptors.size()) * sizeof(float);
  }
};

ScanKeyPoints compute_key_points(const ScanFeatures& scan, const FastRegistrarOptions& options) {
  ScanKeyPoints out;
  const auto drawn = draw_balanced(scan.cloud, static_cast<std::size_t>(options.key_points));
  const Descriptors all = compute_fpfh(scan.cloud, scan.tree, drawn, options.fpfh_radius_m,
                                       static_cast<std::size_t>(options.fpfh_neighbours));
  out.descriptors.resize(kFpfhSize, all.cols());
  for (Eigen::Index i = 0; i < all.cols(); ++i) {
    if (all.col(i).isZero()) continue;
    out.descriptors.col(static_cast<Eigen::Index>(out.indices.size())) = all.col(i);
    out.indices.push_back(drawn[static_cast<std::size_t>(i)]);
  }
  out.descriptors.conservativeResize(kFpfhSize, static_cast<Eigen::Index>(out.indices.size()));
  return out;
}

/// Key points of a submap in the centre's frame.
struct KeyPoints {
  std::vector<Eigen::Vector3f> points;
  std::vector<Eigen::Vector3f> normals;
  Descriptors descriptors;
};

/// The matches that describe each other best: first those that are mutual, then the others, most similar
/// first.
std::vector<Match> match(const KeyPoints& source, const KeyPoints& target, std::size_t max_matches) {
  struct Candidate {
    bool mutual;
    float similarity;
    Eigen::Index source, target;
  };
  const Eigen::Index sources = source.descriptors.cols(), targets = target.descriptors.cols();
  Eigen::ArrayXf best_similarity = Eigen::ArrayXf::Constant(targets, -1.0F);
  std::vector<std::int32_t> best_source(target.points.size(), 0);
  std::vector<Candidate> candidates;
  candidates.reserve(source.points.size());
  constexpr Eigen::Index kBlock = 32;  // similarities of a block stay in the cache while they are searched
  Eigen::MatrixXf similarity(targets, kBlock);
  for (Eigen::Index begin = 0; begin < sources; begin += kBlock) {
    const Eigen::Index width = std::min(kBlock, sources - begin);
    similarity.leftCols(width).noalias() =
        target.descriptors.transpose() * source.descriptors.middleCols(begin, width);
    for (Eigen::Index s = 0; s < width; ++s) {
      const float* values = similarity.col(s).data();
      const float largest = similarity.col(s).maxCoeff();
      const Eigen::Index t = std::find(values, values + targets, largest) - values;
      candidates.push_back({false, largest, begin + s, t});
      const auto here = static_cast<std::int32_t>(begin + s);
      for (Eigen::Index k = 0; k < targets; ++k) {
        const bool better = values[k] > best_similarity[k];
        best_similarity[k] = better ? values[k] : best_similarity[k];
        best_source[static_cast<std::size_t>(k)] = better ? here : best_source[static_cast<std::size_t>(k)];
      }
    }
  }
  for (Candidate& c : candidates) {
    c.mutual = best_source[static_cast<std::size_t>(c.target)] == static_cast<std::int32_t>(c.source);
  }
  std::stable_sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return a.mutual != b.mutual ? a.mutual : a.similarity > b.similarity;
  });
  if (candidates.size() > max_matches)
    candidates.erase(candidates.begin() + static_cast<std::ptrdiff_t>(max_matches), candidates.end());
  std::vector<Match> matches;
  matches.reserve(candidates.size());
  for (const Candidate& c : candidates) {
    const auto s = static_cast<std::size_t>(c.source), t = static_cast<std::size_t>(c.target);
    matches.push_back({source.points[s], target.points[t], source.normals[s], target.normals[t]});
  }
  return matches;
}

/// Share of source points on the target, each counting 1 − (distance / reach)²; normals must agree within
/// 45°.
double score(const PointCloud& source, const std::vector<std::uint32_t>& order, std::size_t count,
             const Submap& target, const Eigen::Isometry3d& T, float reach) {
  const Eigen::Matrix3f R = T.linear().cast<float>();
  double sum = 0.0;
  count = std::min(count, order.size());
  for (std::size_t k = 0; k < count; ++k) {
    const std::uint32_t i = order[k];
    const auto nearest = target.tree().nearest((T * source.points[i].cast<double>()).cast<float>(), reach);
    if (!nearest) continue;
    if (std::abs((R * source.normals[i]).dot(target.cloud().normals[nearest->index])) < 0.7F) continue;
    sum += 1.0 - static_cast<double>(nearest->sq_distance_m2 / (reach * reach));
  }
  return sum / static_cast<double>(std::max<std::size_t>(1, count));
}

}  // namespace

struct FastRegistrar::Impl {
  std::shared_ptr<FeatureCache> features;
  FastRegistrarOptions options;
  mutable BoundedCache<Key, ScanKeyPoints> cache;

  [[nodiscard]] std::shared_ptr<const ScanKeyPoints> scan_key_points(Key key, const ScanFeatures& scan) const {
    return cache.get(
        key, [&](Key) { return std::make_shared<const ScanKeyPoints>(compute_key_points(scan, options)); });
  }

  [[nodiscard]] KeyPoints key_points(const Submap& submap) const {
    std::vector<std::shared_ptr<const ScanKeyPoints>> scans;
    std::size_t count = 0;
    for (const Part& part : submap.parts()) {
      scans.push_back(scan_key_points(part.key, *part.features));
      count += scans.back()->indices.size();
    }
    KeyPoints out;
    out.points.reserve(count);
    out.normals.reserve(count);
    out.descriptors.resize(kFpfhSize, static_cast<Eigen::Index>(count));
    for (std::size_t k = 0; k < scans.size(); ++k) {
      const Part& part = submap.parts()[k];
      const auto begin = static_cast<Eigen::Index>(out.points.size());
      out.descriptors.middleCols(begin, scans[k]->descriptors.cols()) = scans[k]->descriptors;
      const Eigen::Matrix3f R = part.T_center_part.linear().cast<float>();
      for (const std::uint32_t i : scans[k]->indices) {
        out.points.push_back(
            (part.T_center_part * part.features->cloud.points[i].cast<double>()).cast<float>());
        out.normals.push_back(R * part.features->cloud.normals[i]);
      }
    }
    return out;
  }
};

FastRegistrar::FastRegistrar(std::shared_ptr<FeatureCache> features, const FastRegistrarOptions& options)
    : impl_(new Impl{
          std::move(features), options,
          BoundedCache<Key, ScanKeyPoints>(static_cast<std::size_t>(options.max_descriptor_mb * 1e6))}) {
  validate(options);
  if (!impl_->features) throw InputError("a registrar needs a feature cache");
}

FastRegistrar::~FastRegistrar() = default;

void FastRegistrar::prepare(Key key) const {
  if (const auto scan = impl_->features->get(key)) static_cast<void>(impl_->scan_key_points(key, *scan));
}

RegistrationResult FastRegistrar::compute(const RegistrationTask& task) const {
  const FastRegistrarOptions& options = impl_->options;
  RegistrationResult result;
  result.candidate = task.candidate;
  const auto reject = [&](RejectionReason reason, std::string message) {
    result.reason = reason;
    result.message = std::move(message);
    return result;
  };
  Stopwatch features_watch;
  const std::optional<Submap> source =
      Submap::load(*impl_->features, task.source, task.enough_points, result);
  const std::optional<Submap> target =
      source ? Submap::load(*impl_->features, task.target, task.enough_points, result) : std::nullopt;
  if (!target) return result;
  const std::size_t fewest = std::min(source->cloud().size(), target->cloud().size());
  if (fewest < static_cast<std::size_t>(options.tests.min_points)) {
    return reject(RejectionReason::kTooFewPoints,
                  std::to_string(fewest) + " points, must be >= " + std::to_string(options.tests.min_points));
  }
  const std::vector<std::uint32_t> order = draw_balanced(
      source->cloud(), static_cast<std::size_t>(std::max(options.fine_points, options.score_points)));
  if (order.size() < static_cast<std::size_t>(options.tests.min_points)) {
    return reject(RejectionReason::kTooFewPoints,
                  std::to_string(order.size()) +
                      " points with a normal, must be >= " + std::to_string(options.tests.min_points));
  }
  result.features_s = features_watch.seconds();

  const std::vector<GicpPass> passes =
      gicp_passes(options.coarse_reach_m, options.fine_reach_m, static_cast<std::size_t>(options.coarse_points),
                  static_cast<std::size_t>(options.fine_points));
  // Refines a start and measures it; the figures are judged where the pair is decided.
  AlignmentFigures figures;
  GicpResult refined;
  const auto refine = [&](const Eigen::Isometry3d& start) {
    const Stopwatch watch;
    refined = refine_gicp(source->cloud(), order, target->cloud(), target->tree(), start, passes);
    figures = measure_alignment(source->cloud(), target->cloud(), target->tree(), refined.T_target_source,
                                options.tests);
    result.refine_s += watch.seconds();
  };
  const auto decide = [&] {
    judge_alignment(result, refined.T_target_source.inverse(), figures, refined.converged, task.guess_from_to,
                    options.tests);
    return result;
  };

  Stopwatch global_watch;
  const auto scored_points = static_cast<std::size_t>(options.score_points);
  const auto reach = static_cast<float>(options.coarse_reach_m);
  std::vector<Hypothesis> hypotheses;
  if (task.guess_from_to) {
    const Eigen::Isometry3d guess = task.guess_from_to->inverse();
    if (score(source->cloud(), order, scored_points, *target, guess, reach) >= options.min_score) {
      refine(guess);
      if (refined.converged && figures.balanced_overlap >= options.sure_overlap) {
        decide();
        if (result.verified()) return result;
      }
      hypotheses.push_back({refined.T_target_source, 0});
    }
  }
  global_watch = Stopwatch();
  const Stopwatch keys_watch;
  const KeyPoints source_keys = impl_->key_points(*source), target_keys = impl_->key_points(*target);
  const double keys_s = keys_watch.seconds();
  result.features_s += keys_s;
  if (std::min(source_keys.points.size(), target_keys.points.size()) < 3) {
    return reject(RejectionReason::kTooFewPoints, "fewer than 3 key points with a normal and neighbours");
  }
  const std::vector<Match> matches =
      match(source_keys, target_keys, static_cast<std::size_t>(options.max_matches));
  const auto found =
      find_consensus(matches, options.match_tolerance_m, static_cast<std::size_t>(options.hypotheses));
  hypotheses.insert(hypotheses.end(), found.begin(), found.end());
  if (hypotheses.empty()) {
    result.global_s = global_watch.seconds() - keys_s;
    return reject(RejectionReason::kFewMatches,
                  "no three of " + std::to_string(matches.size()) + " matches agree on a pose");
  }
  // A quarter of the points tells which hypotheses are worth all of them.
  std::vector<double> first_look;
  for (const Hypothesis& hypothesis : hypotheses) {
    first_look.push_back(
        score(source->cloud(), order, scored_points / 4, *target, hypothesis.T_target_source, reach));
  }
  const double worth_more = 0.6 * *std::max_element(first_look.begin(), first_look.end());
  double best_score = -1.0;
  Eigen::Isometry3d best = Eigen::Isometry3d::Identity();
  for (std::size_t i = 0; i < hypotheses.size(); ++i) {
    if (first_look[i] < worth_more) continue;
    const double value =
        score(source->cloud(), order, scored_points, *target, hypotheses[i].T_target_source, reach);
    if (value <= best_score) continue;
    best_score = value;
    best = hypotheses[i].T_target_source;
  }
  result.global_s = global_watch.seconds() - keys_s;
  result.T_from_to = best.inverse();
  if (best_score < options.min_score) {
    return reject(RejectionReason::kLowOverlap, "the best of " + std::to_string(hypotheses.size()) +
                                                    " hypotheses scores " + std::to_string(best_score) +
                                                    ", must be >= " + std::to_string(options.min_score));
  }
  refine(best);
  return decide();
}

}  // namespace loopwise
