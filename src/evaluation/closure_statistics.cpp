// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/closure_statistics.hpp>

#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

std::optional<ClosureError> closure_error(const LoopClosure& closure, const PosesByKey& truth) {
  const auto from = truth.find(closure.from);
  const auto to = truth.find(closure.to);
  if (from == truth.end() || to == truth.end()) return std::nullopt;
  const Eigen::Isometry3d error = to->second.inverse() * from->second * closure.T_from_to;
  return ClosureError{error.translation().norm(), se3::rotation_angle(error)};
}

double percent(std::size_t count, std::size_t total) {
  return total == 0 ? 0.0 : 100.0 * static_cast<double>(count) / static_cast<double>(total);
}

ClosureStatistics closure_statistics(const std::vector<RegistrationResult>& results,
                                     const std::vector<double>& weights, std::size_t queued,
                                     const PosesByKey& truth, const ClosureClassOptions& options) {
  validate(options);
  if (weights.size() != results.size()) {
    throw InputError("closure statistics: " + std::to_string(results.size()) + " results, but " +
                     std::to_string(weights.size()) + " weights");
  }
  if (results.size() > queued) {
    throw InputError("closure statistics: " + std::to_string(results.size()) + " results, but only " +
                     std::to_string(queued) + " queued candidates");
  }

  ClosureStatistics out;
  out.queued = queued;
  out.computed = results.size();
  for (std::size_t i = 0; i < results.size(); ++i) {
    if (!results[i].verified()) {
      ++out.rejected[results[i].reason];
      continue;
    }
    ++out.verified;
    const bool kept = weights[i] > options.gnc_inlier_weight;  // false for NaN
    const auto error = closure_error(*results[i].closure, truth);
    const bool right = error && error->translation_m <= options.true_inlier_m &&
                       error->rotation_rad <= options.true_inlier_rad;
    out.gnc_inliers += kept ? 1 : 0;
    out.true_inliers += right ? 1 : 0;
    out.right_inliers += kept && right ? 1 : 0;
    out.without_truth += error ? 0 : 1;
  }
  return out;
}

}  // namespace loopwise
