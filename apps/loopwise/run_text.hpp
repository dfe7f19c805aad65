// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Text of a replay on its closures and poses.
#pragma once

#include <string>

#include <loopwise/evaluation/run_folder.hpp>

namespace loopwise::cli {

/// Whether errors are meaningful. If the odometry was derived from the truth, any closure would increase the
/// error.
[[nodiscard]] bool is_judged(const RunEvaluation& e);

/// For a run without a verified closure: the most frequent reason and what to try. Otherwise empty.
[[nodiscard]] std::string no_closure_text(const RunEvaluation& e);

/// Lines on residuals, errors and differences, if known.
[[nodiscard]] std::string errors_text(const RunEvaluation& e);

/// All results that a replay prints. \param threads those of this machine, for the time of all candidates; 0
/// omits it \param virtual_clock whether the time of registrations was modelled
[[nodiscard]] std::string results_text(const Robots& robots, const ReplayOptions& options,
                                       const ReplayResult& result, const RunEvaluation& e, int threads,
                                       bool virtual_clock);

}  // namespace loopwise::cli
