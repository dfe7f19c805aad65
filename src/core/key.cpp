// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/key.hpp>

#include <charconv>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

bool is_letter(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

}  // namespace

std::string key_name(Key key) {
  const char character = key_character(key);
  if (!is_letter(character)) return std::to_string(key);
  return std::string(1, character) + std::to_string(key_index(key));
}

Key parse_key(std::string_view text) {
  const bool named = !text.empty() && is_letter(text.front());
  const std::string_view digits = named ? text.substr(1) : text;
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
  if (error != std::errc() || end != digits.data() + digits.size() || (named && number > kKeyIndexMask)) {
    throw InputError("\"" + std::string(text) +
                     "\" is not a key: expected a 64-bit number or a letter and an index");
  }
  return named ? make_key(text.front(), number) : number;
}

}  // namespace loopwise
