// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Throws an OptionError that lists the allowed names and puts a similar one first: "unknown option
/// generation.rate, did you mean generation.rate_m? Known: …".
[[noreturn]] LOOPWISE_EXPORT void throw_unknown_name(std::string_view what, std::string_view name,
                                                     const std::vector<std::string>& known);

}  // namespace loopwise
