// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Changes with the code that computes registrations, and with its compiler.
[[nodiscard]] LOOPWISE_EXPORT std::string registration_code_version();

/// The same for all code that affects the outcome of a replay.
[[nodiscard]] LOOPWISE_EXPORT std::string replay_code_version();

}  // namespace loopwise
