// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Errors, differences and residuals in summary.json. A replay writes them, and a report with a truth that
/// the replay did not have writes them again. Private to evaluation.
#pragma once

#include <vector>

#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// Sets all fields of an evaluation except `closures`. \param kept closures that the back end kept
void judge_poses(const Mission& mission, const PosesByKey& optimized, const PosesByKey& odometry,
                 const std::vector<LoopClosure>& kept, RunEvaluation& evaluation);

/// Sets "truth", "reference", "residuals", the errors, "robots" and "closures.true_inliers" of a summary.
void put_errors(const Mission& mission, const RunEvaluation& evaluation, Json& summary);

}  // namespace loopwise
