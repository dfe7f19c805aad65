// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/json_options.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/io/atomic_file.hpp>

#include "file_kind.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

/// Values are copied, compared and written recursively, so deeper values could overflow the stack.
constexpr int kDeepestJson = 200;

std::size_t line_of(std::string_view text, std::size_t byte) {
  const auto end = text.begin() + static_cast<std::ptrdiff_t>(std::min(byte, text.size()));
  return 1 + static_cast<std::size_t>(std::count(text.begin(), end, '\n'));
}

/// The error without the library's prefix "[json.exception.parse_error.101] parse error at line 3, column 7:
/// ".
std::string reason(const std::string& what) {
  const std::size_t column = what.find("column ");
  const std::size_t colon = what.find(": ", column == std::string::npos ? 0 : column);
  return colon == std::string::npos ? what : what.substr(colon + 2);
}

[[noreturn]] void wrong_type(const std::string& name, const Json& value, const std::string& expected) {
  throw OptionError(name + " = " + json_text(value) + ", must be " + expected);
}

[[noreturn]] void wrong_text(const std::string& name, std::string_view text, const std::string& expected) {
  throw OptionError(name + " = " + text::quoted(text) + ", must be " + expected);
}

template <class T>
std::string whole_number_in(T min, T max) {
  return "a whole number in [" + std::to_string(min) + ", " + std::to_string(max) + "]";
}

Json json_number(double value) {
  if (std::isfinite(value)) return value;
  return std::isnan(value) ? "nan" : value > 0.0 ? "inf" : "-inf";  // JSON has no such numbers
}

bool special_number(std::string_view word, double& value) {
  if (word == "inf") {
    value = std::numeric_limits<double>::infinity();
  } else if (word == "-inf") {
    value = -std::numeric_limits<double>::infinity();
  } else if (word == "nan") {
    value = std::numeric_limits<double>::quiet_NaN();
  } else {
    return false;
  }
  return true;
}

}  // namespace

Json parse_json(std::string_view text, const std::string& name) {
  // The parser keeps the last of two equal keys. A configuration with two values for one key is a mistake.
  std::vector<std::set<std::string>> open;
  std::string repeated;
  const auto watch = [&](int depth, Json::parse_event_t event, Json& value) {
    const bool opens =
        event == Json::parse_event_t::object_start || event == Json::parse_event_t::array_start;
    if (depth + (opens ? 1 : 0) > kDeepestJson)
      throw InputError(name + ": nested more than " + std::to_string(kDeepestJson) + " deep");
    if (event == Json::parse_event_t::object_start) open.emplace_back();
    if (event == Json::parse_event_t::object_end) open.pop_back();
    if (event == Json::parse_event_t::key && repeated.empty()) {
      const std::string& key = value.get_ref<const std::string&>();
      if (!open.back().insert(key).second) repeated = key;
    }
    return true;
  };
  Json json;
  try {
    json = Json::parse(text.begin(), text.end(), watch, true, true);
  } catch (const Json::parse_error& error) {
    throw ParseError(name, line_of(text, error.byte == 0 ? 0 : error.byte - 1), reason(error.what()));
  } catch (const Json::out_of_range& error) {
    // A number beyond the range of double. The library names it without its position: "... parsing '1e999'".
    const std::string what = error.what();
    const std::size_t begin = what.find('\''), end = what.rfind('\'');
    const std::string_view number =
        begin < end ? std::string_view(what).substr(begin + 1, end - begin - 1) : std::string_view();
    throw ParseError(name, line_of(text, std::min(text.find(number), text.size())),
                     "number " + text::quoted(number) + " is out of range");
  }
  if (!repeated.empty()) {
    const std::string quoted = Json(repeated).dump();
    const std::size_t first = text.find(quoted);
    const std::size_t second =
        first == std::string_view::npos ? first : text.find(quoted, first + quoted.size());
    throw ParseError(name, second == std::string_view::npos ? 1 : line_of(text, second),
                     "key " + quoted + " is repeated within an object");
  }
  return json;
}

std::string json_text(const Json& json, int indent) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

Json read_json_file(const std::filesystem::path& path) {
  const std::string text = read_file(path);
  refuse_foreign(text, path.string(), {FileKind::kJson, FileKind::kEmpty}, "JSON");
  return parse_json(text, path.string());
}

namespace detail {

bool json_to_bool(const Json& value, const std::string& name) {
  if (!value.is_boolean()) wrong_type(name, value, "true or false");
  return value.get<bool>();
}

std::int64_t json_to_int64(const Json& value, const std::string& name, std::int64_t min, std::int64_t max) {
  const bool fits =
      value.is_number_unsigned()
          ? value.get<std::uint64_t>() <= static_cast<std::uint64_t>(max)
          : value.is_number_integer() && value.get<std::int64_t>() >= min && value.get<std::int64_t>() <= max;
  if (!fits) wrong_type(name, value, whole_number_in(min, max));
  return value.get<std::int64_t>();
}

std::uint64_t json_to_uint64(const Json& value, const std::string& name, std::uint64_t max) {
  // A parsed number is unsigned unless it is negative. A number from a program may be signed.
  const bool fits =
      value.is_number_unsigned() || (value.is_number_integer() && value.get<std::int64_t>() >= 0);
  if (!fits || value.get<std::uint64_t>() > max)
    wrong_type(name, value, whole_number_in(std::uint64_t{0}, max));
  return value.get<std::uint64_t>();
}

double json_to_double(const Json& value, const std::string& name) {
  double special = 0.0;
  if (value.is_string() && special_number(value.get_ref<const std::string&>(), special)) return special;
  if (!value.is_number()) wrong_type(name, value, "a number");
  return value.get<double>();
}

std::string json_to_text(const Json& value, const std::string& name) {
  if (!value.is_string()) wrong_type(name, value, "text in quotes");
  return value.get<std::string>();
}

std::string json_to_words(const Json& value, const std::string& name) {
  if (!value.is_array()) return json_to_text(value, name);
  std::string text;
  for (const Json& word : value) text += (text.empty() ? "" : "+") + json_to_text(word, name);
  return text;
}

std::vector<double> json_to_doubles(const Json& value, const std::string& name) {
  if (!value.is_array()) wrong_type(name, value, "a list of numbers");
  std::vector<double> out;
  for (const Json& element : value) out.push_back(json_to_double(element, name));
  return out;
}

void require_object(const Json& value, const std::string& name) {
  if (!value.is_object()) wrong_type(name, value, "an object {\"name\": value, ...}");
}

std::vector<std::string> json_keys(const Json& object) {
  std::vector<std::string> keys;
  for (const auto& item : object.items()) keys.push_back(item.key());
  return keys;
}

const Json* find_json(const Json& object, std::string_view key) {
  const auto found = object.find(std::string(key));
  return found == object.end() ? nullptr : &*found;
}

bool text_to_bool(std::string_view text, const std::string& name) {
  if (text == "true" || text == "1") return true;
  if (text == "false" || text == "0") return false;
  wrong_text(name, text, "true or false");
}

std::int64_t text_to_int64(std::string_view text, const std::string& name, std::int64_t min,
                           std::int64_t max) {
  std::int64_t value = 0;
  if (!text::parse_int64(text, value) || value < min || value > max) {
    wrong_text(name, text, whole_number_in(min, max));
  }
  return value;
}

std::uint64_t text_to_uint64(std::string_view text, const std::string& name, std::uint64_t max) {
  std::uint64_t value = 0;
  if (text::parse_id(text, value) != nullptr || value > max) {
    wrong_text(name, text, whole_number_in(std::uint64_t{0}, max));
  }
  return value;
}

double text_to_double(std::string_view text, const std::string& name) {
  double value = 0.0;
  if (!special_number(text, value) && text::parse_double(text, value) != text::Number::kOk) {
    wrong_text(name, text, "a number");
  }
  return value;
}

std::vector<double> text_to_doubles(std::string_view text, const std::string& name) {
  std::vector<double> values;
  if (text.size() >= 2 && text.front() == '[' && text.back() == ']') text = text.substr(1, text.size() - 2);
  while (!text::trim(text).empty()) {
    const std::size_t comma = text.find(',');
    values.push_back(text_to_double(text::trim(text.substr(0, comma)), name));
    text = comma == std::string_view::npos ? std::string_view{} : text.substr(comma + 1);
  }
  return values;
}

std::string text_to_text(std::string_view text, const std::string& name) {
  std::string out(text);
  try {
    static_cast<void>(Json(out).dump());
  } catch (const Json::type_error&) {
    wrong_text(name, text, "text in UTF-8");
  }
  return out;
}

static Json value_to_json(const OptionValue& value) {
  return std::visit(
      [](const auto& v) -> Json {
        using T = std::decay_t<decltype(v)>;
        if constexpr (std::is_same_v<T, double>) {
          return json_number(v);
        } else if constexpr (std::is_same_v<T, OptionNumbers>) {
          Json list = Json::array();
          for (const double element : v.values) list.push_back(json_number(element));
          return list;
        } else {
          return v;
        }
      },
      value);
}

Json fields_to_json(const std::vector<OptionField>& fields) {
  Json object = Json::object();
  for (const OptionField& field : fields) object[field.name] = value_to_json(field.value);
  return object;
}

std::string value_text(const OptionValue& value) {
  return json_text(value_to_json(value));
}

void throw_unknown_option(const std::string& section, std::string_view name,
                          const std::vector<OptionField>& known) {
  std::vector<std::string> names;
  names.reserve(known.size());
  for (const OptionField& field : known) names.push_back(section + "." + field.name);
  throw_unknown_name("option", section + "." + std::string(name), names);
}

}  // namespace detail
}  // namespace loopwise
