// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/pcl_registrar.hpp>

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include <pcl/features/fpfh.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/registration/gicp.h>
#include <pcl/search/kdtree.h>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/robust_centre.hpp>
#include "normal_bins.hpp"
#include "submap.hpp"
#include "submap_errors.hpp"

namespace loopwise {
namespace {

using PclCloud = pcl::PointCloud<pcl::PointXYZ>;
using Descriptor = Eigen::Matrix<float, 33, 1>;

/// Key points of a scan and their descriptors.
struct ScanDescriptors {
  std::vector<std::uint32_t> indices;  // into the scan's downsampled cloud
  std::vector<Descriptor> descriptors;
  [[nodiscard]] std::size_t bytes() const {
    return sizeof(*this) + indices.capacity() * sizeof(std::uint32_t) +
           descriptors.capacity() * sizeof(Descriptor);
  }
};

pcl::PointXYZ to_pcl(const Eigen::Vector3f& p) {
  return {p.x(), p.y(), p.z()};
}

ScanDescriptors compute_descriptors(const PointCloud& cloud, const PclRegistrarOptions& options) {
  ScanDescriptors out;
  std::vector<std::uint32_t> key_points = draw_balanced(
      cloud, options.key_points > 0 ? static_cast<std::size_t>(options.key_points) : cloud.size());
  std::sort(key_points.begin(), key_points.end());
  if (key_points.empty()) return out;
  const auto points = pcl::make_shared<PclCloud>();
  const auto normals = pcl::make_shared<pcl::PointCloud<pcl::Normal>>();
  points->reserve(cloud.size());
  normals->reserve(cloud.size());
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    points->push_back(to_pcl(cloud.points[i]));
    normals->push_back({cloud.normals[i].x(), cloud.normals[i].y(), cloud.normals[i].z()});
  }
  const auto indices = pcl::make_shared<pcl::Indices>(key_points.begin(), key_points.end());
  pcl::FPFHEstimation<pcl::PointXYZ, pcl::Normal, pcl::FPFHSignature33> fpfh;
  fpfh.setInputCloud(points);
  fpfh.setInputNormals(normals);
  fpfh.setIndices(indices);
  fpfh.setSearchMethod(pcl::make_shared<pcl::search::KdTree<pcl::PointXYZ>>());
  fpfh.setRadiusSearch(options.fpfh_radius_m);
  pcl::PointCloud<pcl::FPFHSignature33> signatures;
  fpfh.compute(signatures);
  for (std::size_t i = 0; i < signatures.size(); ++i) {
    const Descriptor descriptor = Eigen::Map<const Descriptor>(signatures[i].histogram);
    // The descriptor of a point without neighbours is zero, and equals that of every other such point.
    if (!descriptor.allFinite() || descriptor.isZero()) continue;
    out.indices.push_back(key_points[i]);
    out.descriptors.push_back(descriptor);
  }
  return out;
}

/// Key points of a submap in the centre's frame, with their descriptors.
struct PclKeyPoints {
  std::vector<Eigen::Vector3d> points;
  std::vector<Descriptor> descriptors;
};

/// The `count` nearest of `all` to `query`, nearest first; equal distances by index.
std::vector<std::uint32_t> similar_descriptors(const Descriptor& query, const std::vector<Descriptor>& all,
                                               std::size_t count) {
  std::vector<std::pair<float, std::uint32_t>> best;
  best.reserve(count + 1);
  for (std::uint32_t i = 0; i < all.size(); ++i) {
    const float distance = (all[i] - query).squaredNorm();
    if (best.size() == count && distance >= best.back().first) continue;
    best.insert(std::upper_bound(best.begin(), best.end(), std::make_pair(distance, i)), {distance, i});
    if (best.size() > count) best.pop_back();
  }
  std::vector<std::uint32_t> indices;
  indices.reserve(best.size());
  for (const auto& entry : best) indices.push_back(entry.second);
  return indices;
}

/// Rigid transform of three points onto three others with the least squared error (Umeyama 1991).
Eigen::Isometry3d fit(const std::array<Eigen::Vector3d, 3>& from, const std::array<Eigen::Vector3d, 3>& to) {
  Eigen::Matrix3d a, b;
  for (int i = 0; i < 3; ++i) {
    a.col(i) = from[static_cast<std::size_t>(i)];
    b.col(i) = to[static_cast<std::size_t>(i)];
  }
  return Eigen::Isometry3d(Eigen::umeyama(a, b, false));
}

/// Sample consensus initial alignment: the hypothesis with the least truncated error over the source's key
/// points.
Eigen::Isometry3d initial_alignment(const PclKeyPoints& source, const PclKeyPoints& target,
                                    const KdTree& target_tree,
                                    const std::optional<Eigen::Isometry3d>& guess_to_from, std::uint64_t seed,
                                    const PclRegistrarOptions& options) {
  const double sq_truncation = options.sac_truncation_m * options.sac_truncation_m;
  const auto reach = static_cast<float>(options.sac_truncation_m);
  double least = std::numeric_limits<double>::infinity();
  Eigen::Isometry3d best = Eigen::Isometry3d::Identity();
  const auto try_hypothesis = [&](const Eigen::Isometry3d& T_to_from) {
    double error = 0.0;
    for (const Eigen::Vector3d& point : source.points) {
      const auto nearest = target_tree.nearest((T_to_from * point).cast<float>(), reach);
      error += nearest ? static_cast<double>(nearest->sq_distance_m2) : sq_truncation;
      if (error >= least) return;  // terms are not negative, so the error stays too large
    }
    least = error;
    best = T_to_from;
  };

  Rng rng(seed);
  std::vector<std::vector<std::uint32_t>> matches(source.points.size());
  int hypotheses = 0;
  if (guess_to_from) {
    try_hypothesis(*guess_to_from);
    ++hypotheses;
  }
  for (; hypotheses < options.sac_hypotheses; ++hypotheses) {
    std::array<std::size_t, 3> sample{};
    for (std::size_t i = 0; i < 3; ++i) {
      do {
        sample[i] = static_cast<std::size_t>(rng.below(source.points.size()));
      } while (std::find(sample.begin(), sample.begin() + i, sample[i]) != sample.begin() + i);
    }
    std::array<Eigen::Vector3d, 3> from, to;
    for (std::size_t i = 0; i < 3; ++i) {
      auto& choices = matches[sample[i]];
      if (choices.empty()) {
        choices = similar_descriptors(source.descriptors[sample[i]], target.descriptors,
                                      static_cast<std::size_t>(options.sac_randomness));
      }
      from[i] = source.points[sample[i]];
      to[i] = target.points[choices[static_cast<std::size_t>(rng.below(choices.size()))]];
    }
    const Eigen::Isometry3d hypothesis = fit(from, to);
    if (hypothesis.matrix().allFinite()) try_hypothesis(hypothesis);
  }
  return best;
}

/// Reports whether the steps fell below epsilon. PCL also reports convergence at the limit of iterations.
class Gicp : public pcl::GeneralizedIterativeClosestPoint<pcl::PointXYZ, pcl::PointXYZ> {
 public:
  [[nodiscard]] bool settled() { return hasConverged() && nr_iterations_ < max_iterations_; }
  using Covariances = MatricesVector;
};

/// Points relative to `centre` and covariances of surface elements: flat across the normal, as in the GICP
/// paper.
std::pair<PclCloud::Ptr, pcl::shared_ptr<Gicp::Covariances>> surface_elements(const PointCloud& cloud,
                                                                              const Eigen::Vector3d& centre) {
  constexpr double kFlatness = 0.001;
  auto points = pcl::make_shared<PclCloud>();
  auto covariances = pcl::make_shared<Gicp::Covariances>();
  points->reserve(cloud.size());
  covariances->reserve(cloud.size());
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    points->push_back(to_pcl((cloud.points[i].cast<double>() - centre).cast<float>()));
    const Eigen::Vector3d n = cloud.normals[i].cast<double>();
    covariances->push_back(Eigen::Matrix3d::Identity() - (1.0 - kFlatness) * n * n.transpose());
  }
  return {points, covariances};
}

struct Refinement {
  Eigen::Isometry3d T_to_from;
  bool converged;
};

Refinement refine(const PointCloud& source, const PointCloud& target, const Eigen::Isometry3d& start_to_from,
                  const PclRegistrarOptions& options) {
  // PCL works in float. Clouds about their middles keep the digits of the transform at any position.
  const Eigen::Vector3d source_centre = robust_centre(source.points),
                        target_centre = robust_centre(target.points);
  const auto [source_points, source_covariances] = surface_elements(source, source_centre);
  const auto [target_points, target_covariances] = surface_elements(target, target_centre);
  Gicp gicp;
  gicp.setInputSource(source_points);
  gicp.setInputTarget(target_points);
  gicp.setSourceCovariances(source_covariances);
  gicp.setTargetCovariances(target_covariances);
  gicp.setMaximumIterations(options.gicp_iterations);
  gicp.setMaximumOptimizerIterations(50);
  gicp.setTransformationEpsilon(options.gicp_translation_epsilon_m);
  gicp.setRotationEpsilon(options.gicp_rotation_epsilon);

  Eigen::Isometry3d T =
      Eigen::Translation3d(-target_centre) * start_to_from * Eigen::Translation3d(source_centre);
  bool converged = true;
  for (const double reach : options.max_correspondence_m) {
    gicp.setMaxCorrespondenceDistance(reach);
    PclCloud ignored;
    gicp.align(ignored, T.matrix().cast<float>());
    T.matrix() = gicp.getFinalTransformation().cast<double>();
    converged = gicp.settled();
    if (!T.matrix().allFinite()) break;
    T = se3::normalized(T);
  }
  return {Eigen::Translation3d(target_centre) * T * Eigen::Translation3d(-source_centre), converged};
}

}  // namespace

struct PclRegistrar::Impl {
  std::shared_ptr<FeatureCache> features;
  PclRegistrarOptions options;
  mutable BoundedCache<Key, ScanDescriptors> descriptors;

  [[nodiscard]] PclKeyPoints key_points(const Submap& submap) const {
    PclKeyPoints out;
    for (const Part& part : submap.parts()) {
      const auto scan = descriptors.get(part.key, [&](Key) {
        return std::make_shared<const ScanDescriptors>(compute_descriptors(part.features->cloud, options));
      });
      for (const std::uint32_t i : scan->indices) {
        out.points.push_back(part.T_center_part * part.features->cloud.points[i].cast<double>());
      }
      out.descriptors.insert(out.descriptors.end(), scan->descriptors.begin(), scan->descriptors.end());
    }
    return out;
  }
};

PclRegistrar::PclRegistrar(std::shared_ptr<FeatureCache> features, const PclRegistrarOptions& options)
    : impl_(new Impl{
          std::move(features), options,
          BoundedCache<Key, ScanDescriptors>(static_cast<std::size_t>(options.max_descriptor_mb * 1e6))}) {
  validate(options);
  if (!impl_->features) throw InputError("a registrar needs a feature cache");
}

PclRegistrar::~PclRegistrar() = default;

RegistrationResult PclRegistrar::compute(const RegistrationTask& task) const {
  const PclRegistrarOptions& options = impl_->options;
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
  const std::optional<Submap> source =
      Submap::load(*impl_->features, task.source, task.enough_points, result);
  const std::optional<Submap> target =
      source ? Submap::load(*impl_->features, task.target, task.enough_points, result) : std::nullopt;
  if (!target) return result;
  result.incomplete = source->incomplete() || target->incomplete();
  if (deadline.passed()) return late();
  const std::size_t fewest = std::min(source->cloud().size(), target->cloud().size());
  if (fewest < static_cast<std::size_t>(options.tests.min_points)) {
    return reject(RejectionReason::kTooFewPoints,
                  std::to_string(fewest) + " points, must be >= " + std::to_string(options.tests.min_points));
  }
  const PclKeyPoints source_keys = impl_->key_points(*source), target_keys = impl_->key_points(*target);
  result.features_s = features_watch.seconds();
  if (std::min(source_keys.points.size(), target_keys.points.size()) < 3) {
    return reject(RejectionReason::kTooFewPoints, "fewer than 3 key points with a normal and neighbours");
  }
  if (deadline.passed()) return late();

  Stopwatch global_watch;
  std::optional<Eigen::Isometry3d> guess_to_from;
  if (task.guess_from_to) guess_to_from = task.guess_from_to->inverse();
  const Eigen::Isometry3d coarse =
      initial_alignment(source_keys, target_keys, target->tree(), guess_to_from, task.seed, options);
  double sum_sq = 0.0;
  for (const Eigen::Vector3d& point : source_keys.points) {
    const auto nearest = target->tree().nearest((coarse * point).cast<float>());
    double sq_distance_m2 = std::numeric_limits<double>::infinity();
    if (nearest) sq_distance_m2 = static_cast<double>(nearest->sq_distance_m2);
    sum_sq += sq_distance_m2;
  }
  result.sac_fitness_m2 = sum_sq / static_cast<double>(source_keys.points.size());
  result.T_from_to = coarse.inverse();
  result.global_s = global_watch.seconds();
  if (!(result.sac_fitness_m2 <= options.max_sac_fitness_m2)) {
    return reject(RejectionReason::kSacFitness,
                  "mean squared distance of key points " + std::to_string(result.sac_fitness_m2) +
                      " m^2, must be <= " + std::to_string(options.max_sac_fitness_m2) + " m^2");
  }
  if (deadline.passed()) return late();

  Stopwatch refine_watch;
  const Refinement refined = refine(source->cloud(), target->cloud(), coarse, options);
  AlignmentFigures figures;
  if (refined.T_to_from.matrix().allFinite()) {
    figures =
        measure_alignment(source->cloud(), target->cloud(), target->tree(), refined.T_to_from, options.tests);
  }
  judge_alignment(result, refined.T_to_from.inverse(), figures, refined.converged, task.guess_from_to,
                  options.tests);
  if (result.closure) {
    result.closure->covariance +=
        submap_errors(*source, *target, task, refined.T_to_from, figures, options.tests);
  }
  result.refine_s = refine_watch.seconds();
  return result;
}

}  // namespace loopwise
