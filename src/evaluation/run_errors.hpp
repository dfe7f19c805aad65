// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What summary.json says of errors, differences and residuals: by a replay, and again by a report that knows
/// a truth which the replay did not. Private to evaluation.
#pragma once

#include <vector>

#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// Fills in all of an evaluation but `closures`. \param kept closures that the back end kept
void judge_poses(const Mission& mission, const PosesByKey& optimized, const PosesByKey& odometry,
                 const std::vector<LoopClosure>& kept, RunEvaluation& evaluation);

/// Sets "truth", "reference", "residuals", the errors, "robots" and "closures.true_inliers" of a summary.
void put_errors(const Mission& mission, const RunEvaluation& evaluation, Json& summary);

}  // namespace loopwise
