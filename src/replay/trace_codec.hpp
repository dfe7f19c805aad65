// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include <loopwise/optimization/gnc.hpp>

namespace loopwise {

/// Of poses and weights, to the bit.
[[nodiscard]] std::string estimate_hash(const GncResult& gnc);

}  // namespace loopwise
