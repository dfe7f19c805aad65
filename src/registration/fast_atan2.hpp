// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "../core/constants.hpp"

namespace loopwise {

/// atan2 to 1.2e-5 rad, by the polynomial 4.4.47 of Abramowitz and Stegun (Handbook of Mathematical
/// Functions, 1964). It takes a fraction of the time of the exact function. Of two zeros, the result is
/// finite.
inline float fast_atan2(float y, float x) {
  const float a = std::abs(y), b = std::abs(x);
  const float t = std::min(a, b) / std::max(std::max(a, b), std::numeric_limits<float>::min());
  const float s = t * t;
  const float series = 0.9998660F + s * (-0.3302995F + s * (0.1801410F + s * (-0.0851330F + s * 0.0208351F)));
  const float below = a > b ? 0.5F * kPiFloat - t * series : t * series;
  return std::copysign(x < 0.0F ? kPiFloat - below : below, y);
}

}  // namespace loopwise
