// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string_view>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// The version of the linked library, "MAJOR.MINOR.PATCH". For a shared library it may differ from that of
/// the compiled headers.
[[nodiscard]] LOOPWISE_EXPORT std::string_view version();

}  // namespace loopwise
