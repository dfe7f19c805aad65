// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/core/closure_decision.hpp>
#include <loopwise/core/export.hpp>

namespace loopwise {

/// Reads `decisions.csv`, as the report saves it: columns from, to and decision, which is `accept` or
/// `reject`; a key is a decimal number or a letter and an index.
/// \throws IoError; ParseError, naming the line, also if two lines contradict each other
[[nodiscard]] LOOPWISE_EXPORT std::vector<ClosureDecision> read_decisions(const std::filesystem::path& path);

/// The text of such a file.
[[nodiscard]] LOOPWISE_EXPORT std::string decisions_csv(const std::vector<ClosureDecision>& decisions);

}  // namespace loopwise
