// SPDX-License-Identifier: BSD-3-Clause
#pragma once

namespace loopwise::detail {

/// Whether the character is a letter of ASCII.
[[nodiscard]] constexpr bool is_letter(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

}  // namespace loopwise::detail
