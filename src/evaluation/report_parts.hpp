// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Common parts of the reader of runs and the reader of studies.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// A number if the text is one, null if it is empty or "nan", else the text.
[[nodiscard]] Json csv_cell(const std::string& text);

/// The names of a CSV file's columns. \throws ParseError if it has no line
[[nodiscard]] std::vector<std::string> csv_header(const std::filesystem::path& path);

/// The studies in a folder, by their files: "ablation" (runs.csv), "budget" (curves.csv) and "rssi"
/// (robots.csv) may share one. Each has its rows, medians over mission time, and its own JSON. Empty if there
/// is no study. \throws IoError, ParseError
[[nodiscard]] Json studies_json(const std::filesystem::path& folder, const std::string& label);

}  // namespace loopwise
