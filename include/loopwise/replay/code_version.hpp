// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Changes whenever the code that computes registrations does, or the compiler that it was built with.
[[nodiscard]] LOOPWISE_EXPORT std::string registration_code_version();

/// The same of all that a replay's outcome depends on.
[[nodiscard]] LOOPWISE_EXPORT std::string replay_code_version();

}  // namespace loopwise
