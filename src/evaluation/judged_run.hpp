// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Runs judged after they ended, from what their folders hold. Private to evaluation.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Judges a run by its mission, if that has a truth which the run did not know, or another one; null if no
/// mission is given. Runs of before references took a session's own optimised poses for the truth: what they
/// call errors become differences. \returns whether `summary` says other things of errors than it did
bool judge_run(const std::filesystem::path& folder, const Mission* mission, Json& summary,
               std::vector<std::string>& notes);

/// Whether a column of history.csv is of what the run took for the truth.
[[nodiscard]] bool is_judgement(const std::string& column);

}  // namespace loopwise
