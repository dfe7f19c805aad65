// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <limits>
#include <map>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>

namespace loopwise {

/// Distance of a measured relative pose from the true one: of Y⁻¹·T with Y = Y_from⁻¹ Y_to.
struct ClosureError {
  double translation_m = std::numeric_limits<double>::quiet_NaN();  ///< Length of the translation.
  double rotation_rad = std::numeric_limits<double>::quiet_NaN();   ///< Angle of the rotation, in [0, π].
};

/// Empty if the truth lacks one of the two nodes.
[[nodiscard]] LOOPWISE_EXPORT std::optional<ClosureError> closure_error(const LoopClosure& closure,
                                                                        const PosesByKey& truth);

/// Bounds of the classes. The defaults are the paper's.
struct ClosureClassOptions {
  /// Maximum translation error of a true inlier, m.
  double true_inlier_m = 0.05;
  /// Maximum rotation error of a true inlier, rad.
  double true_inlier_rad = 0.05;
  /// Closures with a larger weight count as kept by the back end.
  double gnc_inlier_weight = 0.5;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("true_inlier_m", self.true_inlier_m, above(0.0));
    field("true_inlier_rad", self.true_inlier_rad, above(0.0));
    field("gnc_inlier_weight", self.gnc_inlier_weight, between(0.0, 1.0));
  }
};

/// Outcomes of a run's candidates, in the classes of the paper's Table I. Shares are of `queued`.
struct ClosureStatistics {
  std::size_t queued = 0;       ///< Generated and not pruned by the method, computed or not.
  std::size_t computed = 0;     ///< verified + Σ rejected
  std::size_t verified = 0;     ///< Passed all tests of the computation.
  std::size_t gnc_inliers = 0;  ///< Verified, and kept by the back end.
  /// Verified, and within the bounds of the truth, independent of the back end.
  std::size_t true_inliers = 0;
  std::size_t right_inliers = 0;  ///< GNC inliers that are true inliers.
  std::size_t without_truth = 0;  ///< Verified, but the truth lacks a node: never a true inlier.
  /// Computed candidates that were refused, by reason; reasons that did not occur are absent.
  std::map<RejectionReason, std::size_t> rejected;
};

/// Share of `count` in `total` in percent; 0 of 0 is 0.
[[nodiscard]] LOOPWISE_EXPORT double percent(std::size_t count, std::size_t total);

/// `weights[i]` is the last weight that the back end gave to `results[i]`; not used if that is not verified,
/// and NaN for a closure that the back end never got, which is not an inlier. `queued` counts the computed
/// ones too.
/// \throws InputError unless there are as many weights as results and at most `queued` of them; OptionError.
[[nodiscard]] LOOPWISE_EXPORT ClosureStatistics
closure_statistics(const std::vector<RegistrationResult>& results, const std::vector<double>& weights,
                   std::size_t queued, const PosesByKey& truth, const ClosureClassOptions& options = {});

}  // namespace loopwise
