// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Fits the chances of ExpectedPrioritizer to missions, and says how good they are on missions that the fit
/// has not seen.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/prioritization/acceptance.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// What was known of a candidate when it was handed out, and what came of it.
struct AcceptanceSample {
  CandidateEvidence evidence;  ///< By the estimate of that moment.
  bool verified = false;       ///< Passed registration.
  bool right = false;          ///< Verified, and robust optimisation kept it to the end.
};

/// Candidates of one mission.
struct AcceptanceSamples {
  std::string mission;                    ///< Its name.
  std::vector<AcceptanceSample> samples;  ///< In the order of their results.
};

/// Replays a mission with candidates in random order, so that what is computed is a fair sample of what is
/// generated, and records the evidence of each.
/// \param mission with its scans
/// \param options of the replay; the method is not used
/// \param registration that computes the candidates
/// \param threads for the registrations
/// \param hooks to watch the run, or to stop it: the samples are then those that there were
/// \throws OptionError; InputError
[[nodiscard]] LOOPWISE_EXPORT AcceptanceSamples collect_acceptance(const Mission& mission,
                                                                   const ReplayOptions& options,
                                                                   const Registration& registration,
                                                                   ThreadPool& threads,
                                                                   const ReplayHooks& hooks = {});

/// How well a model ranks and foretells samples that it was not fitted to. Figures are NaN where the other
/// missions have no sample of each outcome, which allows no fit.
struct AcceptanceScore {
  std::string mission;           ///< Left out of the fit.
  std::size_t count = 0;         ///< Of samples.
  std::size_t positive = 0;      ///< Of them, with the outcome that the model foretells.
  double auc = 0.0;              ///< Area under the ROC curve; NaN if all samples are alike.
  double brier = 0.0;            ///< Mean squared error of the chances; NaN without samples.
  double auc_by_distance = 0.0;  ///< Of the order by distance alone, for comparison.
};

/// Weights fitted to all missions, and scores of fits that left one mission out at a time.
struct AcceptanceFit {
  AcceptanceModel::Terms weights{};     ///< For AcceptanceModel.
  std::vector<AcceptanceScore> scores;  ///< A mission each; empty for a single mission.
  Calibration calibration;              ///< Of all left-out samples that have a score together.
};

/// Which outcome a model foretells.
enum class AcceptanceOutcome {
  kVerified,  ///< Of all samples.
  kRight,     ///< Of the verified ones.
};

/// Fits one of the two models. \throws InputError without a sample of each outcome
[[nodiscard]] LOOPWISE_EXPORT AcceptanceFit fit_acceptance(const std::vector<AcceptanceSamples>& missions,
                                                           AcceptanceOutcome outcome);

/// Area under the ROC curve of scores: the share of pairs of a positive and a negative sample in which the
/// positive one has the higher score, ties counting half. NaN if all are alike. \throws InputError if the
/// sizes differ or a score is NaN
[[nodiscard]] LOOPWISE_EXPORT double roc_auc(const std::vector<double>& scores,
                                             const std::vector<bool>& positive);

}  // namespace loopwise
