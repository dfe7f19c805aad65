// SPDX-License-Identifier: BSD-3-Clause
#include "run_text.hpp"

#include <algorithm>

#include "command.hpp"

namespace loopwise::cli {
namespace {

/// Advice that may help registrations which fail for this reason.
const char* advice_on(RejectionReason reason) {
  switch (reason) {
    case RejectionReason::kNone:
      break;
    case RejectionReason::kMissingScan:
    case RejectionReason::kFailed:
      return "scans cannot be read: see the problems of 'loopwise info'";
    case RejectionReason::kTooFewPoints:
    case RejectionReason::kFewMatches:
    case RejectionReason::kSacFitness:
    case RejectionReason::kGicpFitness:
    case RejectionReason::kNotConverged:
    case RejectionReason::kDegenerate:
      return "scans are too sparse or too far apart: of sweeps make denser ones by --submap 10 and a smaller "
             "--keyframe-distance, else --set task.target_neighbours=5; 'loopwise register A B' tries two "
             "scans";
    case RejectionReason::kLowOverlap:
      return "the pairs have hardly a surface in common: try --set generation.radius_max_m=10, another "
             "--method, or "
             "more registrations; if the robot did pass a place twice, check the frame of the scans by "
             "'loopwise "
             "register A B'";
    case RejectionReason::kInconsistent:
    case RejectionReason::kAmbiguous:
      return "places look alike: only pairs with more in common can be distinguished, try --set "
             "generation.radius_max_m=10 or denser scans by --submap 10";
    case RejectionReason::kTransformThreshold:
      return "results are far from where odometry has them: state its drift, --set "
             "mission.odometry_sigma_m_per_m=0.05, "
             "or give no guess, --set task.use_guess=false";
    case RejectionReason::kTimeLimit:
      return "registrations take longer than task.time_limit_s allows";
  }
  return "";
}

}  // namespace

std::string no_closure_text(const RunEvaluation& e) {
  const auto& rejected = e.closures.rejected;
  if (e.closures.verified > 0 || rejected.empty()) return {};
  const auto most = std::max_element(rejected.begin(), rejected.end(),
                                     [](const auto& a, const auto& b) { return a.second < b.second; });
  if (most->second == 0) return {};
  std::size_t all = 0;
  for (const auto& [reason, count] : rejected) all += count;
  return "no closure   of " + std::to_string(all) + " registrations, " + std::to_string(most->second) +
         " failed by " + std::string(enum_name(most->first)) + ": " + advice_on(most->first) + "\n";
}

bool is_judged(const RunEvaluation& e) {
  return e.has_truth && e.odometry.ate_m.max > 1e-6;
}

std::string errors_text(const RunEvaluation& e) {
  std::string text;
  if (e.residuals.translation_m.count > 0) {
    text += "residuals    " + fixed(e.residuals.translation_m.median, 3) + " m in the median of the " +
            std::to_string(e.residuals.translation_m.count) + " closures kept, " +
            fixed(e.odometry_residuals.translation_m.median, 3) + " m by odometry\n";
  }
  if (is_judged(e)) {
    const bool aligned = e.optimized.alignment != Alignment::kNone;
    text += "ATE mean     " + fixed(e.odometry.ate_m.mean, 3) + " m by odometry, " +
            fixed(e.optimized.ate_m.mean, 3) + " m optimised" +
            (aligned ? ", aligned: the truth is in another frame"
                     : " (aligned: " + fixed(e.odometry_aligned.ate_m.mean, 3) + ", " +
                           fixed(e.optimized_aligned.ate_m.mean, 3) + ")") +
            "\n";
  } else if (e.has_truth) {
    text +=
        "ATE          not judged: odometry and truth are the same poses; --odometry-noise 0.05 0.01 makes "
        "the "
        "odometry worse\n";
  }
  if (e.has_reference && e.odometry_reference.ate_m.max > 1e-6) {
    text += "reference    " + fixed(e.odometry_reference.ate_m.mean, 3) + " m by odometry, " +
            fixed(e.optimized_reference.ate_m.mean, 3) +
            " m optimised: mean difference from the session's own optimised poses, which are not the truth\n";
  }
  return text;
}

}  // namespace loopwise::cli
