// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Fits the probabilities of ExpectedPrioritizer to missions, and evaluates them on other missions.
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

/// Evidence on a candidate when it was handed out, and its outcome.
struct AcceptanceSample {
  CandidateEvidence evidence;  ///< By the estimate at that time.
  bool verified = false;       ///< Passed registration.
  bool right = false;          ///< Verified, and robust optimisation kept it to the end.
};

/// Samples of one mission.
struct AcceptanceSamples {
  std::string mission;                    ///< Its name.
  std::vector<AcceptanceSample> samples;  ///< In the order of their results.
};

/// Replays a mission with candidates in random order, so that the computed candidates are a fair sample of
/// the generated ones, and records the evidence of each.
/// \param mission with its scans
/// \param options of the replay; the method is not used
/// \param registration that computes the candidates
/// \param threads for the registrations
/// \param hooks to watch the run, or to stop it: the result then has the samples so far
/// \throws OptionError; InputError
[[nodiscard]] LOOPWISE_EXPORT AcceptanceSamples collect_acceptance(const Mission& mission,
                                                                   const ReplayOptions& options,
                                                                   const Registration& registration,
                                                                   ThreadPool& threads,
                                                                   const ReplayHooks& hooks = {});

/// Ranking and calibration of a model on samples outside of its fit. Figures are NaN if the other missions
/// lack samples of an outcome, which allows no fit.
struct AcceptanceScore {
  std::string mission;           ///< Left out of the fit.
  std::size_t count = 0;         ///< Of samples.
  std::size_t positive = 0;      ///< Number of samples with the predicted outcome.
  double auc = 0.0;              ///< Area under the ROC curve; NaN if all samples have the same outcome.
  double brier = 0.0;            ///< Mean squared error of the probabilities; NaN without samples.
  double auc_by_distance = 0.0;  ///< Of the order by distance alone, for comparison.
};

/// Weights fitted to all missions, and scores of fits that left one mission out at a time.
struct AcceptanceFit {
  AcceptanceModel::Terms weights{};     ///< For AcceptanceModel.
  std::vector<AcceptanceScore> scores;  ///< A mission each; empty for a single mission.
  Calibration calibration;              ///< Over all left-out samples with a score.
};

/// The outcome that a model predicts.
enum class AcceptanceOutcome {
  kVerified,  ///< Of all samples.
  kRight,     ///< Of the verified ones.
};

/// Fits one of the two models. \throws InputError without a sample of each outcome
[[nodiscard]] LOOPWISE_EXPORT AcceptanceFit fit_acceptance(const std::vector<AcceptanceSamples>& missions,
                                                           AcceptanceOutcome outcome);

/// Area under the ROC curve of scores: the share of pairs of a positive and a negative sample in which the
/// positive one has the higher score, ties counting half. NaN if all have the same outcome. \throws
/// InputError if the sizes differ or a score is NaN
[[nodiscard]] LOOPWISE_EXPORT double roc_auc(const std::vector<double>& scores,
                                             const std::vector<bool>& positive);

}  // namespace loopwise
