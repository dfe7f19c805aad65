// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/options.hpp>

namespace loopwise::detail {
namespace {

struct OptionText {
  std::string_view type;
  std::string_view field;
  std::string_view text;
};

constexpr OptionText kOptionTexts[] = {
#include "option_texts.inc"  // made by cmake/option_texts.awk
};

}  // namespace

std::string_view option_text(std::string_view type, std::string_view field) {
  for (const OptionText& row : kOptionTexts) {
    if (row.field == field && row.type == type) return row.text;
  }
  return {};
}

}  // namespace loopwise::detail
