// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The results of a replay as text for people.
#pragma once

#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/replay/options.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Circumstances of a run that affect the lines on its computation.
struct RunTextOptions {
  int threads = 0;            ///< Of this machine, for the time of all candidates; 0 omits it.
  bool virtual_clock = true;  ///< Whether the time of registrations was modelled.
};

/// Whether errors against the truth are meaningful. If odometry and truth are the same poses, every closure
/// would increase the error.
[[nodiscard]] LOOPWISE_EXPORT bool is_judged(const RunEvaluation& evaluation);

/// A line for each result: candidates, closures, reasons of rejections with a remedy if no closure was
/// verified, errors, times. Remedies and hints name options of `loopwise replay`. The same figures with
/// stable names are in run_summary_json().
[[nodiscard]] LOOPWISE_EXPORT std::string run_results_text(const Robots& robots, const ReplayOptions& options,
                                                           const ReplayResult& result,
                                                           const RunEvaluation& evaluation,
                                                           const RunTextOptions& about = {});

}  // namespace loopwise
