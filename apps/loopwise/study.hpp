// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "command.hpp"

namespace loopwise::cli {

/// Adds `study registration`.
void add_registration_study(CLI::App& study, Action& chosen);

}  // namespace loopwise::cli
