// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string_view>

namespace loopwise {

/// The page that web/ bundles, with the mark "@LOOPWISE_DATA@" where its data go; empty if this build has
/// none. Defined by web/build.mjs or by report_absent.cpp.
[[nodiscard]] std::string_view report_template();

}  // namespace loopwise
