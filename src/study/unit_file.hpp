// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The file that a study keeps of each unit. See docs/formats.md.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/run_history.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise::study {

inline constexpr int kUnitFormat = 1;  ///< Increase it when the contents of unit files change.

/// Result of a unit: its summary without wall times, and the history.
struct UnitResult {
  Json summary;
  std::vector<HistoryRow> history;
};

/// The file's contents. `mission` identifies the unit's mission.
[[nodiscard]] Json unit_file_json(Json mission, Json summary, const std::vector<HistoryRow>& history);

/// \throws InputError naming `name` and the part that unit_file_json() would write differently
[[nodiscard]] UnitResult parse_unit_file(const Json& unit, const std::string& name);

/// A number of a unit's summary, by the path of its names; NaN if missing.
[[nodiscard]] double figure(const Json& summary, const std::vector<std::string>& path);

}  // namespace loopwise::study
