// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/icp_registrar.hpp>

#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include <Eigen/Geometry>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "submap.hpp"

namespace loopwise {
namespace {

/// Points of both clouds that belong together, and their mean squared distance.
struct Matches {
  Eigen::Matrix3Xd source, target;
  double fitness_m2 = std::numeric_limits<double>::infinity();
};

/// Each point of the source, moved by T, with its nearest point of the target.
Matches match(const PointCloud& source, const Submap& target, const Eigen::Isometry3d& T_to_from,
              double reach_m) {
  Matches out;
  const auto count = static_cast<Eigen::Index>(source.size());
  out.source.resize(3, count);
  out.target.resize(3, count);
  Eigen::Index n = 0;
  double sum = 0.0;
  for (const Eigen::Vector3f& point : source.points) {
    const Eigen::Vector3d moved = T_to_from * point.cast<double>();
    const auto nearest = target.tree().nearest(moved.cast<float>(), static_cast<float>(reach_m));
    if (!nearest) continue;
    out.source.col(n) = moved;
    out.target.col(n++) = target.cloud().points[nearest->index].cast<double>();
    sum += static_cast<double>(nearest->sq_distance_m2);
  }
  out.source.conservativeResize(3, n);
  out.target.conservativeResize(3, n);
  if (n > 0) out.fitness_m2 = sum / static_cast<double>(n);
  return out;
}

}  // namespace

IcpRegistrar::IcpRegistrar(std::shared_ptr<FeatureCache> features, const IcpRegistrarOptions& options)
    : features_(std::move(features)), options_(options) {
  validate(options_);
  if (!features_) throw InputError("a registrar needs a feature cache");
}

RegistrationResult IcpRegistrar::compute(const RegistrationTask& task) const {
  RegistrationResult result;
  result.candidate = task.candidate;
  const auto reject = [&](RejectionReason reason, std::string message) {
    result.reason = reason;
    result.message = std::move(message);
    return result;
  };
  const Deadline deadline(task.time_limit_s);
  Stopwatch features_watch;
  const std::optional<Submap> source = Submap::load(*features_, task.source, task.enough_points, result);
  const std::optional<Submap> target =
      source ? Submap::load(*features_, task.target, task.enough_points, result) : std::nullopt;
  if (!target) return result;
  result.incomplete = source->incomplete() || target->incomplete();
  result.features_s = features_watch.seconds();
  constexpr Eigen::Index kFewest = 3;  // for a rigid motion

  Stopwatch refine_watch;
  Eigen::Isometry3d T =
      task.guess_from_to ? task.guess_from_to->inverse() : Eigen::Isometry3d(Eigen::Isometry3d::Identity());
  Matches matches = match(source->cloud(), *target, T, options_.max_correspondence_m);
  for (int i = 0; i < options_.iterations; ++i) {
    if (deadline.passed()) {
      return reject(RejectionReason::kTimeLimit,
                    "not done after " + std::to_string(task.time_limit_s) + " s");
    }
    if (matches.source.cols() < kFewest) {
      return reject(
          RejectionReason::kTooFewPoints,
          std::to_string(matches.source.cols()) + " matched points, must be >= " + std::to_string(kFewest));
    }
    const Eigen::Isometry3d step(Eigen::umeyama(matches.source, matches.target, false));
    if (!step.matrix().allFinite()) return reject(RejectionReason::kNotConverged, "step is not finite");
    T = se3::normalized(step * T);
    const double before = matches.fitness_m2;
    matches = match(source->cloud(), *target, T, options_.max_correspondence_m);
    const Vector6d moved = se3::log(step);
    if (moved.head<3>().norm() < options_.epsilon && moved.tail<3>().norm() < options_.epsilon) break;
    if (std::abs(before - matches.fitness_m2) < options_.epsilon * options_.epsilon) break;
  }
  result.T_from_to = T.inverse();
  // Like PCL's fitness, over all points, however far from the target.
  result.gicp_fitness_m2 =
      match(source->cloud(), *target, T, std::numeric_limits<double>::infinity()).fitness_m2;
  result.refine_s = refine_watch.seconds();
  if (!(result.gicp_fitness_m2 <= options_.max_fitness_m2)) {
    return reject(RejectionReason::kGicpFitness,
                  "mean squared distance " + std::to_string(result.gicp_fitness_m2) +
                      " m^2, must be <= " + std::to_string(options_.max_fitness_m2) + " m^2");
  }
  result.closure = LoopClosure{task.candidate.from, task.candidate.to, *result.T_from_to,
                               options_.sigma * options_.sigma * Matrix6d::Identity()};
  return result;
}

}  // namespace loopwise
