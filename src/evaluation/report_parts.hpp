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

/// A study's folder as the page wants it: rows of runs, medians over mission time, its own JSON.
/// \throws IoError, ParseError
[[nodiscard]] Json study_json(const std::filesystem::path& folder, const std::string& label);

}  // namespace loopwise
