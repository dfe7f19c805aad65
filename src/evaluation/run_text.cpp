// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/run_text.hpp>

#include <algorithm>
#include <map>

#include <loopwise/evaluation/closure_statistics.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/replay/cost_forecast.hpp>

namespace loopwise {
namespace {

/// Advice for registrations that fail for this reason.
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
      return "scans are too sparse or too far apart: make denser ones from sweeps by --submap 10 and a "
             "smaller --keyframe-distance, otherwise --set task.target_neighbours=5; 'loopwise register A B' "
             "tries two "
             "scans";
    case RejectionReason::kLowOverlap:
      return "the pairs have hardly any common surface: try --set generation.radius_max_m=10, another "
             "--method, or "
             "more registrations; if the robot visited a place twice, check the frame of the scans by "
             "'loopwise "
             "register A B'; if odometry is worse than its stated covariance, --set "
             "fast_registrar.guess_sigmas=0 searches further";
    case RejectionReason::kInconsistent:
    case RejectionReason::kAmbiguous:
      return "places look alike: only pairs with more in common can be distinguished, try --set "
             "generation.radius_max_m=10 or denser scans by --submap 10";
    case RejectionReason::kTransformThreshold:
      return "results are far from the prediction by odometry: state its drift, --set "
             "mission.odometry_sigma_m_per_m=0.05, "
             "or give no guess, --set task.use_guess=false";
    case RejectionReason::kTimeLimit:
      return "registrations take longer than task.time_limit_s allows";
  }
  return "";
}

std::string reasons_text(const std::string& what, const std::map<std::string, std::size_t>& reasons) {
  std::string text;
  for (const auto& [reason, count] : reasons)
    text += (text.empty() ? "" : ", ") + std::to_string(count) + " " + reason;
  return text.empty() ? text : what + std::string(13 - what.size(), ' ') + text + "\n";
}

/// Predicted and observed shares of verified candidates.
std::string calibration_text(const ReplayResult& result) {
  std::string text;
  for (const auto& [name, calibration] : result.calibration) {
    double expected = 0.0;
    std::size_t verified = 0, count = 0;
    for (const Calibration::Bin& bin : calibration.bins()) {
      expected += bin.expected;
      verified += bin.verified;
      count += bin.count;
    }
    if (count == 0) continue;
    text += "predicted    " + fixed(100.0 * expected / static_cast<double>(count), 1) +
            " % verified by method " + name + ", observed " +
            fixed(100.0 * static_cast<double>(verified) / static_cast<double>(count), 1) +
            " % (Brier score " + fixed(calibration.brier(), 3) + ")\n";
  }
  return text;
}

/// Closures between robots or sessions. If they are verified but not kept, the common frame is wrong.
std::string between_robots_text(const Robots& robots, const ReplayResult& result) {
  if (robots.size() < 2) return {};
  const double inlier_weight = ClosureClassOptions().gnc_inlier_weight;
  std::size_t verified = 0, kept = 0;
  for (const ComputedCandidate& computed : result.computed) {
    if (!computed.result.verified()) continue;
    const LoopClosure& closure = *computed.result.closure;
    if (robots.of(closure.from) == robots.of(closure.to)) continue;
    ++verified;
    kept += computed.weight > inlier_weight ? 1 : 0;
  }
  std::string text = "between      " + counted(verified, "verified closure") + " of different robots, " +
                     std::to_string(kept) + " kept";
  if (verified >= 8 && 2 * kept < verified)
    text += ": most contradict the robots' common frame or each other; check --frames and the priors";
  return text + "\n";
}

/// For a run without a verified closure: the most frequent reason and what to try. Otherwise empty.
std::string no_closure_text(const RunEvaluation& e, const CandidateAccounting& candidates) {
  if (candidates.generated > 0 && candidates.pruned == candidates.generated)
    return "no closure   the method pruned all candidates: another --method computes them\n";
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

/// Lines on residuals, errors and differences, if known.
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

/// Lines on candidates that were not computed, or a hint if there are no such candidates.
std::string pending_text(const ReplayOptions& options, const ReplayResult& result,
                         const RunTextOptions& about) {
  const CandidateAccounting& a = result.accounting;
  std::string text;
  // A live run shows by itself what it computes.
  if (about.threads > 0 && a.pending > 0 && about.virtual_clock) {
    const std::string all = forecast_text(forecast_cost(result), about.threads);
    if (!all.empty()) text += "all of them  " + all + "\n";
  }
  const auto most = static_cast<std::size_t>(options.max_registrations);
  if (a.pending > 0 && most > 0 && a.computed >= most) {
    text += "pending      " + std::to_string(a.pending) + " beyond --max-registrations\n";
  } else if (a.pending > 0 && !options.after_mission) {
    text += "pending      " + std::to_string(a.pending) + " not computed when the mission ended" +
            (!about.virtual_clock || options.cost.measured_time
                 ? std::string()
                 : ", by a modelled computer of " +
                       counted(static_cast<std::size_t>(options.cost.workers), "worker") + " and " +
                       fixed(options.cost.registration_time_s, 1) + " s a registration") +
            ": --after-mission computes them too\n";
  } else if (a.pending == 0 && a.pruned == 0 && a.expired == 0 && a.computed > 0) {
    text += "order        all candidates were computed: the method hardly matters\n";
  }
  return text;
}

}  // namespace

bool is_judged(const RunEvaluation& e) {
  return e.has_truth && e.odometry.ate_m.max > 1e-6;
}

std::string run_results_text(const Robots& robots, const ReplayOptions& options, const ReplayResult& result,
                             const RunEvaluation& e, const RunTextOptions& about) {
  const CandidateAccounting& a = result.accounting;
  const auto share = [&](std::size_t count) {
    return std::to_string(count) + " (" + fixed(percent(count, a.queued()), 2) + " % of queued)";
  };
  std::string text = "candidates   " + std::to_string(a.generated) + " generated, " +
                     std::to_string(a.pruned) + " pruned, " + std::to_string(a.expired) + " expired, " +
                     std::to_string(a.computed) + " computed, " + std::to_string(a.pending) + " pending\n";
  text += reasons_text("pruned", result.pruned) + reasons_text("expired", result.expired);
  text +=
      "verified     " + share(e.closures.verified) + "\nGNC inliers  " + share(e.closures.gnc_inliers) + "\n";
  text += between_robots_text(robots, result);
  if (is_judged(e)) {
    text += "true inliers " + share(e.closures.true_inliers) + ": within 0.05 m and 0.05 rad of the truth" +
            (e.closures.without_truth == 0
                 ? "\n"
                 : "; " + std::to_string(e.closures.without_truth) + " of the verified ones have none\n");
  }
  std::map<std::string, std::size_t> rejected;
  for (const auto& [reason, count] : e.closures.rejected) rejected[std::string(enum_name(reason))] = count;
  text += reasons_text("rejected", rejected) + no_closure_text(e, a) + calibration_text(result);
  text += errors_text(e);
  text += "time         " + fixed(result.mission_time_s, 1) + " s of the mission, " +
          fixed(result.total_s, 1) + " s of work: " + fixed(result.registration_s, 1) + " s registration, " +
          fixed(result.optimization_s, 1) + " s optimisation, " + fixed(result.decision_s, 1) +
          " s candidates and their order, method " + to_string(options.prioritization.method) + "\n";
  return result.interrupted ? text : text + pending_text(options, result, about);
}

}  // namespace loopwise
