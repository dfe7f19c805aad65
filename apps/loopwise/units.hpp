// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Units of the texts that the command line prints.
#pragma once

namespace loopwise::cli {

inline constexpr double kDegreesPerRadian = 57.29577951308232;

}  // namespace loopwise::cli
