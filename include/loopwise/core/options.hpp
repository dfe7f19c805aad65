// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options structs describe their own fields once: a static member template lists the fields with their
/// bounds and, in a project of your own, their texts:
///
///     struct SearchOptions {
///       double rate_m = 0.2;
///
///       template <class Self, class Visitor>
///       static void visit(Self& self, Visitor&& field) {
///         field("rate_m", self.rate_m, at_least(0.0), "Search radius gained per node index, m.");
///       }
///     };
///
/// where Self is the struct or its const form. Validation, JSON and the printed reference use that
/// description. A field may be bool, an integer, double, std::string, an enum with an `enum_names` overload,
/// a std::vector<double>, or a std::vector of such an enum with the overloads `parse_option(name, text,
/// field)` and `option_text(field)`.
///
/// Loopwise's own headers have the text as a comment above the field instead, which its build compiles into
/// the library; comments of other projects are not read, and without the fourth argument the text is empty.
/// A visitor gives that argument the default `std::string_view text = {}`. describe(), to_json() and
/// set_option() are in io/json_options.hpp.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <sstream>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/export.hpp>

namespace loopwise {

/// Allowed range of a number, or of each element of a vector. Ignored for text, bool and enums.
struct Bounds {
  double min = -std::numeric_limits<double>::infinity();  ///< Least value.
  double max = std::numeric_limits<double>::infinity();   ///< Largest value; it is allowed.
  bool open_min = false;                                  ///< min itself is not allowed.

  /// Whether the value is allowed; NaN is never allowed.
  [[nodiscard]] bool contains(double value) const {
    return (open_min ? value > min : value >= min) && value <= max;  // false for NaN
  }
};

/// No bounds.
[[nodiscard]] constexpr Bounds any_value() {
  return {};
}
/// ≥ min.
[[nodiscard]] constexpr Bounds at_least(double min) {
  return {min, std::numeric_limits<double>::infinity(), false};
}
/// > min.
[[nodiscard]] constexpr Bounds above(double min) {
  return {min, std::numeric_limits<double>::infinity(), true};
}
/// In [min, max].
[[nodiscard]] constexpr Bounds between(double min, double max) {
  return {min, max, false};
}

/// "> 0", "in [0, 1]", ">= 1"; empty if every value is allowed.
[[nodiscard]] inline std::string to_string(const Bounds& bounds) {
  std::ostringstream out;
  if (std::isfinite(bounds.max)) {
    if (std::isfinite(bounds.min)) {
      out << "in " << (bounds.open_min ? "(" : "[") << bounds.min << ", " << bounds.max << "]";
    } else {
      out << "<= " << bounds.max;
    }
  } else if (std::isfinite(bounds.min)) {
    out << (bounds.open_min ? "> " : ">= ") << bounds.min;
  }
  return out.str();
}

/// Enumerators with their words in files and on the command line. An enum of the options needs an overload of
/// `enum_names(E)` in its own namespace that returns such a list.
template <class E>
using EnumNames = std::vector<std::pair<E, std::string_view>>;

/// The word for an enumerator. \throws OptionError if it has no word.
template <class E>
[[nodiscard]] std::string enum_name(E value) {
  for (const auto& [enumerator, name] : enum_names(E{})) {
    if (enumerator == value) return std::string(name);
  }
  throw OptionError("enumerator without a name");
}

/// The enumerator for a word. \throws OptionError naming `what`, the word and the allowed ones.
template <class E>
[[nodiscard]] E parse_enum(std::string_view what, std::string_view word) {
  std::string allowed;
  for (const auto& [enumerator, name] : enum_names(E{})) {
    if (name == word) return enumerator;
    allowed += (allowed.empty() ? "" : ", ") + std::string(name);
  }
  throw OptionError(std::string(what) + " = \"" + std::string(word) + "\", must be one of: " + allowed);
}

namespace detail {

/// The comment above the field of the options struct `type`, such as "loopwise::ProximityOptions"; empty if
/// it is no struct of this library.
[[nodiscard]] LOOPWISE_EXPORT std::string_view option_text(std::string_view type, std::string_view field);

/// The qualified name of a type, from the name of this function: gcc writes "... type_name() [with T =
/// loopwise::ProximityOptions; ...]" and clang "... type_name() [T = loopwise::ProximityOptions]".
template <class T>
[[nodiscard]] std::string_view type_name() {
  const std::string_view function = __PRETTY_FUNCTION__;
  const std::size_t begin = function.find("T = ") + 4;
  return function.substr(begin, function.find_first_of(";]", begin) - begin);
}

/// The text of a field of Options: the one that visit() gives, else the comment above the field.
template <class Options>
[[nodiscard]] std::string_view field_text(std::string_view field, std::string_view given) {
  return given.empty() ? option_text(type_name<Options>(), field) : given;
}

template <class T>
struct IsListOfWords : std::false_type {};
template <class E>
struct IsListOfWords<std::vector<E>> : std::is_enum<E> {};
template <class T>
inline constexpr bool is_list_of_words = IsListOfWords<T>::value;

inline void check_bounds(std::string_view name, double value, const Bounds& bounds) {
  if (bounds.contains(value)) return;
  std::ostringstream out;
  out << name << " = " << value << ", must be " << (std::isnan(value) ? "a number" : to_string(bounds));
  throw OptionError(out.str());
}

struct BoundsVisitor {
  template <class T>
  void operator()(std::string_view name, const T& value, const Bounds& bounds, std::string_view = {}) const {
    if constexpr (std::is_arithmetic_v<T> && !std::is_same_v<T, bool>) {
      check_bounds(name, static_cast<double>(value), bounds);
    } else if constexpr (std::is_same_v<T, std::vector<double>>) {
      for (const double v : value) check_bounds(name, v, bounds);
    }
  }
};

}  // namespace detail

/// Lists the fields of a part of an options struct as fields of the struct itself: `visit_part(self.tests,
/// field)` in its visit(). The texts are those of the part.
template <class Part, class Visitor>
void visit_part(Part& part, Visitor&& field) {
  using Options = std::remove_const_t<Part>;
  Options::visit(
      part, [&field](std::string_view name, auto& value, const Bounds& bounds, std::string_view text = {}) {
        field(name, value, bounds, detail::field_text<Options>(name, text));
      });
}

/// Checks every field against its bounds. \throws OptionError naming the first bad field.
template <class Options>
void validate(const Options& options) {
  Options::visit(options, detail::BoundsVisitor{});
}

/// Checks a struct of several sections. Its static member template `visit_sections(self, visitor)` calls
/// visitor(name, section) for each. \throws OptionError naming "section.field" of the first bad field.
template <class Sections>
void validate_sections(const Sections& sections) {
  Sections::visit_sections(sections, [](std::string_view name, const auto& section) {
    try {
      validate(section);
    } catch (const OptionError& error) {
      throw OptionError(std::string(name) + "." + error.what());
    }
  });
}

}  // namespace loopwise
