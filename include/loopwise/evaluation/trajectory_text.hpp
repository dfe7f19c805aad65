// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Errors of trajectories as JSON and as text.
#pragma once

#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>

namespace loopwise {

/// All errors as a JSON object, as `loopwise evaluate` prints them; null for unknown numbers.
[[nodiscard]] LOOPWISE_EXPORT std::string trajectory_errors_json(const TrajectoryErrors& errors);

/// A table with a row for each robot and one for all of them: path, largest and mean errors.
[[nodiscard]] LOOPWISE_EXPORT std::string trajectory_errors_table(const TrajectoryErrors& errors);

}  // namespace loopwise
