// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The output of `loopwise rank`.
#pragma once

#include <string>

#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/rank.hpp>

namespace loopwise::cli {

/// Numbers of candidates, traces, and the ranked candidates with their scores.
[[nodiscard]] Json ranking_json(const Ranking& ranking);
/// A table of the first candidates, and the figures of all. \param method its name
[[nodiscard]] std::string ranking_text(const Ranking& ranking, const std::string& method);

}  // namespace loopwise::cli
