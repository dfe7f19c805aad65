// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Numbers that several components use.
#pragma once

#include <limits>

namespace loopwise {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
inline constexpr double kPi = 3.14159265358979323846;
inline constexpr float kPiFloat = static_cast<float>(kPi);
inline constexpr double kDegree = kPi / 180.0;
inline constexpr double kDegreesPerRadian = 180.0 / kPi;

}  // namespace loopwise
