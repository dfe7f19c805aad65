// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>

namespace loopwise {

/// Reads pairs that another place recognition proposes: CSV with the header `from,to`, and in any order after
/// it `score` (similarity in [0, 1]) and the guessed pose T_from_to as `x,y,z,qx,qy,qz,qw`, metres. Values
/// may be empty, those of a pose only all seven together. The candidates have the source kUser. Score and
/// pose become their recognition, with a covariance of (1 m)² and (0.1 rad)². \throws IoError; ParseError
/// naming line and column
[[nodiscard]] LOOPWISE_EXPORT std::vector<LoopCandidate> read_candidates(const std::filesystem::path& path);

/// The same for a text in memory; `source` replaces the file's name in errors.
[[nodiscard]] LOOPWISE_EXPORT std::vector<LoopCandidate> parse_candidates(std::string_view text,
                                                                          const std::string& source);

}  // namespace loopwise
