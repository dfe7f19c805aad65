// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/key.hpp>

#include <charconv>

#include <loopwise/core/error.hpp>

#include "letters.hpp"

namespace loopwise {
namespace {

constexpr Key kLabelledIndexMask = (Key{1} << kKeyLabelShift) - 1;

}  // namespace

char key_label(Key key) {
  const char label = static_cast<char>(key >> kKeyLabelShift);
  return detail::is_letter(key_character(key)) && detail::is_letter(label) ? label : '\0';
}

std::string key_name(Key key) {
  const char character = key_character(key);
  if (!detail::is_letter(character)) return std::to_string(key);
  const char label = key_label(key);
  if (label == '\0') return std::string(1, character) + std::to_string(key_index(key));
  return std::string{character, label} + std::to_string(key & kLabelledIndexMask);
}

Key parse_key(std::string_view text) {
  std::size_t letters = 0;
  while (letters < 2 && letters < text.size() && detail::is_letter(text[letters])) ++letters;
  const std::string_view digits = text.substr(letters);
  constexpr Key kLargest[] = {~Key{0}, kKeyIndexMask, kLabelledIndexMask};
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
  if (error != std::errc() || end != digits.data() + digits.size() || number > kLargest[letters]) {
    throw InputError("\"" + std::string(text) +
                     "\" is not a key: expected a 64-bit number, or one or two letters and an index");
  }
  if (letters == 0) return number;
  const Key label = letters == 2 ? static_cast<unsigned char>(text[1]) : 0;
  return make_key(text[0], (label << kKeyLabelShift) | number);
}

}  // namespace loopwise
