// SPDX-License-Identifier: BSD-3-Clause
// A message definition, an empty byte, then a message. Every word of the definition is asked for as a field.
#include "ros_message.hpp"

#include "target.hpp"
#include "text.hpp"

namespace {

using namespace loopwise;

void look(const ros1::Value& value, const std::vector<std::string>& names, int depth) {
  static_cast<void>(fuzz::attempt([&] { return value.number(); }));
  static_cast<void>(fuzz::attempt([&] { return value.integer(); }));
  static_cast<void>(fuzz::attempt([&] { return value.unsigned_integer(); }));
  static_cast<void>(fuzz::attempt([&] { return value.text().size(); }));
  static_cast<void>(fuzz::attempt([&] { return value.time_ns(); }));
  static_cast<void>(fuzz::attempt([&] { return value.raw().size(); }));
  const auto numbers = fuzz::attempt([&] { return value.numbers(); });
  const auto size = fuzz::attempt([&] { return value.size(); });
  fuzz::expect(!numbers || (size && numbers->size() == *size), "an array has as many numbers as elements");
  if (depth == 3) return;
  for (const std::string& name : names) {
    if (!value.has(name)) continue;
    const ros1::Value field = value.at(name);  // the message has it, and was found whole
    look(field, names, depth + 1);
    std::size_t seen = 0;
    struct Enough {};
    try {
      static_cast<void>(fuzz::attempt([&] {
        field.for_each([&](const ros1::Value& element) {
          look(element, names, depth + 1);
          if (++seen == 3) throw Enough();
        });
        return true;
      }));
    } catch (const Enough&) {
    }
  }
}

}  // namespace

LOOPWISE_FUZZ_TARGET(ros_message, bytes) {
  const std::size_t end = std::min(bytes.find('\0'), bytes.size());
  const std::string definition(bytes.substr(0, end));
  const std::string_view message = bytes.substr(std::min(end + 1, bytes.size()));
  const auto schema = fuzz::attempt([&] { return ros1::Schema("fuzz_msgs/Fuzz", definition); });
  if (!schema) return;
  std::vector<std::string> names;
  text::Lines lines(definition);
  for (std::string_view line; lines.next(line) && names.size() < 8;) {
    static_cast<void>(text::next_word(line));
    const std::string_view name = text::next_word(line);
    if (!name.empty()) names.emplace_back(name);
  }
  const auto value = fuzz::attempt([&] { return ros1::Value(*schema, message); });
  if (value) look(*value, names, 0);
}
