// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options structs (core/options.hpp) to and from JSON, text and printed tables, from their description. A
/// configuration file is an object of sections, {"generation": {"rate_m": 0.3}, ...}: its reader calls
/// apply_json() once per section. Include <nlohmann/json.hpp> to access the values.
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/core/names.hpp>
#include <loopwise/core/options.hpp>

namespace loopwise {

/// Keeps the order of its keys.
using Json = nlohmann::ordered_json;

/// Parses a JSON text; // comments are allowed. `name` replaces the file's name in errors.
/// \throws ParseError naming the line, also for a key that is repeated within an object or a number out of
/// range; InputError if values are nested more than 200 deep.
[[nodiscard]] LOOPWISE_EXPORT Json parse_json(std::string_view text, const std::string& name);
/// \throws IoError; ParseError, InputError as parse_json()
[[nodiscard]] LOOPWISE_EXPORT Json read_json_file(const std::filesystem::path& path);

/// As text, indented by `indent` blanks or, below 0, on one line. Names of files, topics and robots may hold
/// any bytes, but JSON may not: bytes that are not UTF-8 become U+FFFD.
[[nodiscard]] LOOPWISE_EXPORT std::string json_text(const Json& json, int indent = -1);

/// One option, for people.
struct OptionDescription {
  std::string name;           ///< Of the field, and the key in JSON.
  std::string type;           ///< "bool", "integer", "number", "text", "word", "words", "numbers"
  std::string default_value;  ///< As JSON.
  std::string bounds;         ///< "> 0", "one of: fast, pcl"; empty if any value is allowed.
  std::string doc;            ///< Meaning and unit.
};

namespace detail {

// One JSON value, with the name that errors give it. All throw OptionError on a value of the wrong type.
[[nodiscard]] LOOPWISE_EXPORT bool json_to_bool(const Json& value, const std::string& name);
[[nodiscard]] LOOPWISE_EXPORT std::int64_t json_to_int64(const Json& value, const std::string& name,
                                                         std::int64_t min, std::int64_t max);
[[nodiscard]] LOOPWISE_EXPORT std::uint64_t json_to_uint64(const Json& value, const std::string& name,
                                                           std::uint64_t max);
[[nodiscard]] LOOPWISE_EXPORT double json_to_double(const Json& value,
                                                    const std::string& name);  // also "inf", "-inf", "nan"
[[nodiscard]] LOOPWISE_EXPORT std::string json_to_text(const Json& value, const std::string& name);
[[nodiscard]] LOOPWISE_EXPORT std::vector<double> json_to_doubles(const Json& value, const std::string& name);
/// A text as it is; a list of words joined by "+".
[[nodiscard]] LOOPWISE_EXPORT std::string json_to_words(const Json& value, const std::string& name);

LOOPWISE_EXPORT void require_object(const Json& value, const std::string& name);
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::string> json_keys(const Json& object);
[[nodiscard]] LOOPWISE_EXPORT const Json* find_json(const Json& object, std::string_view key);
// The same from text. Throw OptionError if the text is something else.
[[nodiscard]] LOOPWISE_EXPORT bool text_to_bool(std::string_view text, const std::string& name);
[[nodiscard]] LOOPWISE_EXPORT std::int64_t text_to_int64(std::string_view text, const std::string& name,
                                                         std::int64_t min, std::int64_t max);
[[nodiscard]] LOOPWISE_EXPORT std::uint64_t text_to_uint64(std::string_view text, const std::string& name,
                                                           std::uint64_t max);
[[nodiscard]] LOOPWISE_EXPORT double text_to_double(std::string_view text, const std::string& name);
[[nodiscard]] LOOPWISE_EXPORT std::vector<double> text_to_doubles(std::string_view text,
                                                                  const std::string& name);
/// As it is; OptionError unless it is UTF-8, as all text in JSON is.
[[nodiscard]] LOOPWISE_EXPORT std::string text_to_text(std::string_view text, const std::string& name);

/// A list. It is a separate type because libstdc++ 12 treats a variant of numbers, strings and vectors as
/// never valueless, and crashes if a copy of it fails to allocate.
struct OptionNumbers {
  std::vector<double> values;
};
using OptionValue = std::variant<bool, std::int64_t, std::uint64_t, double, std::string, OptionNumbers>;
struct OptionField {
  std::string name;
  OptionValue value;
  OptionDescription description;
};
[[nodiscard]] LOOPWISE_EXPORT Json fields_to_json(const std::vector<OptionField>& fields);
[[nodiscard]] LOOPWISE_EXPORT std::string value_text(const OptionValue& value);
[[noreturn]] LOOPWISE_EXPORT void throw_unknown_option(const std::string& section, std::string_view name,
                                                       const std::vector<OptionField>& known);

template <class T>
void from_json_value(const Json& value, const std::string& name, T& field) {
  if constexpr (std::is_same_v<T, bool>) {
    field = json_to_bool(value, name);
  } else if constexpr (std::is_enum_v<T>) {
    field = parse_enum<T>(name, json_to_text(value, name));
  } else if constexpr (std::is_integral_v<T> && std::is_signed_v<T>) {
    using Limits = std::numeric_limits<T>;
    field = static_cast<T>(json_to_int64(value, name, Limits::min(), Limits::max()));
  } else if constexpr (std::is_integral_v<T>) {
    field = static_cast<T>(json_to_uint64(value, name, std::numeric_limits<T>::max()));
  } else if constexpr (std::is_floating_point_v<T>) {
    field = static_cast<T>(json_to_double(value, name));
  } else if constexpr (std::is_same_v<T, std::string>) {
    field = json_to_text(value, name);
  } else if constexpr (is_list_of_words<T>) {
    parse_option(name, json_to_words(value, name), field);
  } else {
    static_assert(std::is_same_v<T, std::vector<double>>, "a field type that options do not have");
    field = json_to_doubles(value, name);
  }
}

template <class T>
void from_text_value(std::string_view text, const std::string& name, T& field) {
  if constexpr (std::is_same_v<T, bool>) {
    field = text_to_bool(text, name);
  } else if constexpr (std::is_enum_v<T>) {
    field = parse_enum<T>(name, text);
  } else if constexpr (std::is_integral_v<T> && std::is_signed_v<T>) {
    using Limits = std::numeric_limits<T>;
    field = static_cast<T>(text_to_int64(text, name, Limits::min(), Limits::max()));
  } else if constexpr (std::is_integral_v<T>) {
    field = static_cast<T>(text_to_uint64(text, name, std::numeric_limits<T>::max()));
  } else if constexpr (std::is_floating_point_v<T>) {
    field = static_cast<T>(text_to_double(text, name));
  } else if constexpr (std::is_same_v<T, std::string>) {
    field = text_to_text(text, name);
  } else if constexpr (is_list_of_words<T>) {
    parse_option(name, text, field);
  } else {
    field = text_to_doubles(text, name);
  }
}

template <class T>
[[nodiscard]] OptionValue option_value(const T& field) {
  if constexpr (std::is_enum_v<T>) {
    return enum_name(field);
  } else if constexpr (std::is_integral_v<T> && !std::is_same_v<T, bool>) {
    return static_cast<std::conditional_t<std::is_signed_v<T>, std::int64_t, std::uint64_t>>(field);
  } else if constexpr (std::is_floating_point_v<T>) {
    return static_cast<double>(field);
  } else if constexpr (std::is_same_v<T, std::vector<double>>) {
    return OptionNumbers{field};
  } else if constexpr (is_list_of_words<T>) {
    return option_text(field);
  } else {
    return field;
  }
}

template <class T>
[[nodiscard]] std::string type_word() {
  if constexpr (std::is_same_v<T, bool>) return "bool";
  if constexpr (std::is_enum_v<T>) return "word";
  if constexpr (std::is_integral_v<T>) return "integer";
  if constexpr (std::is_floating_point_v<T>) return "number";
  if constexpr (std::is_same_v<T, std::string>) return "text";
  if constexpr (is_list_of_words<T>) return "words";
  return "numbers";
}

template <class T>
[[nodiscard]] std::string bounds_text(const Bounds& bounds) {
  if constexpr (std::is_enum_v<T>) {
    std::string words;
    for (const auto& [enumerator, word] : enum_names(T{}))
      words += (words.empty() ? "" : ", ") + std::string(word);
    return "one of: " + words;
  } else if constexpr (std::is_same_v<T, std::string> || std::is_same_v<T, bool> || is_list_of_words<T>) {
    return "";
  } else {
    return to_string(bounds);
  }
}

template <class Options>
[[nodiscard]] std::vector<OptionField> option_fields(const Options& options) {
  std::vector<OptionField> fields;
  Options::visit(options, [&](std::string_view name, const auto& field, const Bounds& bounds,
                              std::string_view text = {}) {
    using T = std::decay_t<decltype(field)>;
    const OptionValue value = option_value(field);
    fields.push_back({std::string(name),
                      value,
                      {std::string(name), type_word<T>(), value_text(value), bounds_text<T>(bounds),
                       std::string(field_text<Options>(name, text))}});
  });
  return fields;
}

}  // namespace detail

/// Names, types, values (of a fresh struct: the defaults), bounds and meaning of all fields, in order of
/// declaration.
template <class Options>
[[nodiscard]] std::vector<OptionDescription> describe(const Options& options) {
  std::vector<OptionDescription> descriptions;
  for (auto& field : detail::option_fields(options)) descriptions.push_back(std::move(field.description));
  return descriptions;
}

/// All fields with their present values, a Json as apply_json() takes it. (`auto`, since the type is only
/// declared here.)
template <class Options>
[[nodiscard]] auto to_json(const Options& options) {
  return detail::fields_to_json(detail::option_fields(options));
}

/// Sets the fields in the object and checks all bounds; other fields keep their values. On an error `options`
/// are unchanged.
/// \throws OptionError naming "section.key": an unknown key, a value of the wrong type or out of bounds.
template <class Options>
void apply_json(const Json& object, const std::string& section, Options& options) {
  detail::require_object(object, section);
  const std::vector<detail::OptionField> fields = detail::option_fields(options);
  for (const std::string& key : detail::json_keys(object)) {
    const auto has_name = [&key](const detail::OptionField& field) { return field.name == key; };
    if (std::none_of(fields.begin(), fields.end(), has_name))
      detail::throw_unknown_option(section, key, fields);
  }
  Options changed = options;
  Options::visit(changed,
                 [&](std::string_view name, auto& field, const Bounds& bounds, std::string_view = {}) {
                   const std::string full = section + "." + std::string(name);
                   if (const Json* value = detail::find_json(object, name))
                     detail::from_json_value(*value, full, field);
                   detail::BoundsVisitor{}(full, field, bounds);
                 });
  options = std::move(changed);
}

/// Sets one field from text, as on a command line: set_option("generation", "rate_m", "0.3", options). Words
/// and texts need no quotes; the numbers of a list are separated by commas. \throws OptionError as
/// apply_json()
template <class Options>
void set_option(const std::string& section, std::string_view name, std::string_view text, Options& options) {
  Options changed = options;
  bool found = false;
  Options::visit(changed,
                 [&](std::string_view own, auto& field, const Bounds& bounds, std::string_view = {}) {
                   if (own != name) return;
                   found = true;
                   const std::string full = section + "." + std::string(own);
                   detail::from_text_value(text, full, field);
                   detail::BoundsVisitor{}(full, field, bounds);
                 });
  if (!found) detail::throw_unknown_option(section, name, detail::option_fields(options));
  options = std::move(changed);
}

}  // namespace loopwise
