// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

namespace loopwise::detail {

/// Where residuals of right closures end, if some are beyond a threshold that follows the noise of most of
/// them. From the threshold on, the tail of right closures thins out, while false ones become more frequent
/// with their residual: the number of random poses with a squared residual below s grows as s³. So the tail
/// ends where fewest closures are, before they become more frequent again: at the largest such value.
/// \param r2 squared residuals or innovations of closures, in any order
/// \param low threshold of the noise, above 0 \param high stated threshold, above `low`
/// \returns a threshold in [low, high]; `low` unless clearly fewer closures are near the result
[[nodiscard]] double end_of_tail(std::vector<double> r2, double low, double high);

}  // namespace loopwise::detail
