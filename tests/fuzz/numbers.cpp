// SPDX-License-Identifier: BSD-3-Clause
// Words as numbers, held against the C library's reading of the same words.
#include <cmath>
#include <cstdlib>
#include <string>

#include <loopwise/core/key.hpp>

#include "target.hpp"
#include "text.hpp"

namespace {

using namespace loopwise;

void check_double(const std::string& word) {
  double value = 0.0;
  const text::Number parsed = text::parse_double(word, value);
  if (parsed == text::Number::kNotANumber) return;
  char* end = nullptr;
  const double other = std::strtod(word.c_str(), &end);
  fuzz::expect(end == word.c_str() + word.size(), "what is a number to us is one to the C library");
  if (parsed == text::Number::kNotFinite) {
    fuzz::expect(!std::isfinite(other), "a number that is not finite");
    return;
  }
  // Below the smallest normal number we may give 0.
  fuzz::expect(value == other || (value == 0.0 && std::abs(other) < 1e-300), "numbers are the same");
  std::string digits;
  text::append(digits, value);
  double again = 0.0;
  fuzz::expect(text::parse_double(digits, again) == text::Number::kOk && again == value,
               "written and read again: the same");
}

void check_seconds(const std::string& word) {
  const auto ns = text::parse_seconds_ns(word);
  if (!ns) return;
  const long double exact = std::strtold(word.c_str(), nullptr) * 1e9L;
  fuzz::expect(std::abs(static_cast<long double>(*ns) - exact) <= 2.0L,
               "seconds are the nanoseconds they say");
}

}  // namespace

LOOPWISE_FUZZ_TARGET(numbers, bytes) {
  text::Lines lines(bytes);
  for (std::string_view line; lines.next(line);) {
    for (std::string_view word = text::next_word(line); !word.empty(); word = text::next_word(line)) {
      const std::string copy(word.substr(0, word.find('\0')));
      if (copy.empty()) continue;
      check_double(copy);
      check_seconds(copy);
      std::uint64_t id = 0;
      if (text::parse_id(copy, id) == nullptr) {
        fuzz::expect(id == std::strtoull(copy.c_str(), nullptr, 10), "ids are the same");
      }
      std::int64_t number = 0;
      if (text::parse_int64(copy, number)) {
        fuzz::expect(number == std::strtoll(copy.c_str(), nullptr, 10), "whole numbers are the same");
      }
      const auto key = fuzz::attempt([&] { return parse_key(copy); });
      if (key) fuzz::expect(parse_key(key_name(*key)) == *key, "a key's name is the key");
    }
  }
}
