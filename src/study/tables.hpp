// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Cells and tables of the studies of replays.
#pragma once

#include <string>
#include <vector>

#include <loopwise/evaluation/sample_statistics.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_values.hpp>

#include "scheduler.hpp"

namespace loopwise::study {

/// "0.123 (0.100–0.150)": median and quartiles; without the brackets for one value.
[[nodiscard]] std::string cell(const Quartiles& q, int decimals);
/// "0.123 (0.100 to 0.150)", without the brackets if the interval is unknown.
[[nodiscard]] std::string cell(double value, const Interval& interval, int decimals);
/// "0.100 to 0.150", or "-" if the interval is unknown.
[[nodiscard]] std::string text_of(const Interval& interval, int decimals);

/// Shortest text that reads back to the same bits; empty for NaN.
[[nodiscard]] std::string number_text(double value);

/// The columns that identify the run of a row, and their values.
[[nodiscard]] std::vector<std::string> run_columns();
[[nodiscard]] std::vector<std::string> run_cells(const Study& study, const StudyUnit& unit,
                                                 const UnitResult& result);

/// The names in the format of to_string(Method): "full" for "gi+obs". \throws OptionError if the list is
/// empty, or a name is unknown or repeated.
[[nodiscard]] std::vector<std::string> canonical_methods(const std::vector<std::string>& methods);

/// The object of this name within another; created empty if missing. Indexing a JSON null makes it an object,
/// but without memory the library leaves a value that cannot be destroyed.
[[nodiscard]] Json& object_at(Json& parent, const std::string& name);

[[nodiscard]] Json quartiles_json(const std::vector<double>& values);
[[nodiscard]] Json interval_json(const Interval& interval);
[[nodiscard]] Json comparison_json(const PairedComparison& c);

/// The missions of a world, in the order given.
struct World {
  std::string name;
  std::vector<std::size_t> missions;
  std::vector<std::string> parameters;  ///< Distinct parameters_sha256 of its missions.
};
/// In the order of their first missions.
[[nodiscard]] std::vector<World> worlds_of(const std::vector<StudyMission>& missions);

/// "tunnel: 5 missions, parameters e7c1510012d8".
[[nodiscard]] std::string describe(const World& world);

/// Frame of the ATE: "in the common frame without alignment", unless truths are in other frames.
[[nodiscard]] std::string frame_text(const std::vector<StudyMission>& missions);

/// A sentence on the replays of the missions.
[[nodiscard]] std::string budget_text(const Config& config);

}  // namespace loopwise::study
