// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Evaluates runs after their end, from the files in their folders. Private to evaluation.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Evaluates a run with its mission, if that has a truth that the run did not have, or another one; null if
/// no mission is given. Old runs, from before references existed, used a session's own optimised poses as the
/// truth: their errors become differences. \returns whether the errors in `summary` have changed
bool judge_run(const std::filesystem::path& folder, const Mission* mission, Json& summary,
               std::vector<std::string>& notes);

/// Whether a column of history.csv depends on the poses that the run used as the truth.
[[nodiscard]] bool is_judgement(const std::string& column);

}  // namespace loopwise
