// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What the reader of runs and that of studies share.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// A number where the text is one, null where it is empty or "nan", else the text.
[[nodiscard]] Json csv_cell(const std::string& text);

/// The names of a CSV file's columns. \throws ParseError if it has no line
[[nodiscard]] std::vector<std::string> csv_header(const std::filesystem::path& path);

/// The studies that a folder holds, by their files: "ablation" (runs.csv), "budget" (curves.csv) and "rssi"
/// (robots.csv) may share one. Of each its rows, medians over mission time, and its own JSON. Empty if it
/// holds none. \throws IoError, ParseError
[[nodiscard]] Json studies_json(const std::filesystem::path& folder, const std::string& label);

}  // namespace loopwise
