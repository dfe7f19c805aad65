// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

namespace loopwise {

/// Changes whenever the code that computes registrations does, or the compiler that it was built with.
[[nodiscard]] std::string registration_code_version();

/// The same of all that a replay's outcome depends on.
[[nodiscard]] std::string replay_code_version();

}  // namespace loopwise
