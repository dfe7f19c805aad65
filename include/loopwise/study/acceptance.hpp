// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The study of chances: how likely a candidate is verified, and a verified closure kept.
#pragma once

#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/evaluation/acceptance_fit.hpp>

namespace loopwise::study {

/// Chances fitted to missions.
struct AcceptanceReport {
  std::string weights;                ///< A configuration file with the fitted weights, for read_config().
  std::string json;                   ///< Weights and scores of missions left out.
  std::string markdown;               ///< The same for people.
  std::vector<std::string> problems;  ///< Models without a fit, and the reasons.
};

/// Fits both models of ExpectedPrioritizer to the samples of collect_acceptance(), and evaluates them on
/// missions left out. \throws InputError if neither can be fitted
[[nodiscard]] LOOPWISE_EXPORT AcceptanceReport fit_chances(const std::vector<AcceptanceSamples>& missions);

}  // namespace loopwise::study
