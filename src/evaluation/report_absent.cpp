// SPDX-License-Identifier: BSD-3-Clause
#include "report_template.hpp"

namespace loopwise {

std::string_view report_template() {
  return {};
}

}  // namespace loopwise
