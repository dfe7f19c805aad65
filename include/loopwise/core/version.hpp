// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string_view>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// The version of the library that runs, "MAJOR.MINOR.PATCH": for a shared library not necessarily the one
/// whose headers were compiled.
[[nodiscard]] LOOPWISE_EXPORT std::string_view version();

}  // namespace loopwise
