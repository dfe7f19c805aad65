// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Text of a replay on its closures and poses.
#pragma once

#include <string>

#include <loopwise/evaluation/run_folder.hpp>

namespace loopwise::cli {

/// Whether there are errors to speak of: errors against what the odometry was taken from would say of
/// closures that they make things worse.
[[nodiscard]] bool is_judged(const RunEvaluation& e);

/// Of a run that verified no closure: the most frequent reason and what to try. Else empty.
[[nodiscard]] std::string no_closure_text(const RunEvaluation& e);

/// Lines on residuals, errors and differences, as far as they are known.
[[nodiscard]] std::string errors_text(const RunEvaluation& e);

/// All that a replay prints of its results. `threads`: those of this machine, for the time of all candidates;
/// 0 leaves it out. `virtual_clock`: the time of registrations was modelled.
[[nodiscard]] std::string results_text(const Robots& robots, const ReplayOptions& options,
                                       const ReplayResult& result, const RunEvaluation& e, int threads,
                                       bool virtual_clock);

}  // namespace loopwise::cli
