// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Numbers and tables as text.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// "12.3" with the given number of decimals; "-" for NaN.
[[nodiscard]] LOOPWISE_EXPORT std::string fixed(double value, int decimals);

/// A count with its noun: "1 closure", "3 closures"; `several` is the plural if it is not formed by an s.
[[nodiscard]] LOOPWISE_EXPORT std::string counted(std::size_t count, const std::string& noun,
                                                  const std::string& several = "");

/// Rows of equal length as text in columns, the first row underlined.
[[nodiscard]] LOOPWISE_EXPORT std::string table(const std::vector<std::vector<std::string>>& rows);

/// Rows of equal length as a table of Markdown, the first one the header.
[[nodiscard]] LOOPWISE_EXPORT std::string markdown_table(const std::vector<std::vector<std::string>>& rows);

}  // namespace loopwise
