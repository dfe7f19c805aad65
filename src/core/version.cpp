// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/version.hpp>

namespace loopwise {

std::string_view version() {
  return LOOPWISE_VERSION;
}

}  // namespace loopwise
