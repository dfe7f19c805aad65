// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include <loopwise/optimization/gnc.hpp>

namespace loopwise {

/// Hash of poses and weights, exact to the bit.
[[nodiscard]] std::string estimate_hash(const GncResult& gnc);

}  // namespace loopwise
