// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/registration_result.hpp>

namespace loopwise {

EnumNames<RejectionReason> enum_names(RejectionReason) {
  return {{RejectionReason::kNone, ""},
          {RejectionReason::kMissingScan, "missing_scan"},
          {RejectionReason::kTooFewPoints, "too_few_points"},
          {RejectionReason::kFewMatches, "few_matches"},
          {RejectionReason::kSacFitness, "sac_fitness"},
          {RejectionReason::kGicpFitness, "gicp_fitness"},
          {RejectionReason::kLowOverlap, "low_overlap"},
          {RejectionReason::kInconsistent, "inconsistent"},
          {RejectionReason::kAmbiguous, "ambiguous"},
          {RejectionReason::kDegenerate, "degenerate"},
          {RejectionReason::kTransformThreshold, "transform_threshold"},
          {RejectionReason::kNotConverged, "not_converged"},
          {RejectionReason::kFailed, "failed"},
          {RejectionReason::kTimeLimit, "time_limit"}};
}

}  // namespace loopwise
