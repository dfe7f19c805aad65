// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <limits>
#include <string>

#include <CLI/CLI.hpp>

#include "command_line.hpp"

namespace loopwise::cli {
namespace {

Check check_of(CLI::Validator validator) {
  return Check(std::make_shared<const CLI::Validator>(std::move(validator)));
}

/// NaN if the text is not a finite number.
double number(const std::string& text) {
  double value = 0.0;
  const bool is_number = CLI::detail::lexical_cast(text, value) && std::isfinite(value);
  return is_number ? value : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

Check::Check(const std::function<std::string(const std::string&)>& refusal)
    : validator_(std::make_shared<const CLI::Validator>(
          [refusal](std::string& text) { return refusal(text); }, "")) {}

Check in_range(int least, int most) {
  return check_of(CLI::Range(least, most));
}
Check in_range(double least, double most) {
  return check_of(CLI::Range(least, most));
}
Check positive_number() {
  return Check([](const std::string& text) { return number(text) > 0.0 ? "" : text + " must be > 0"; });
}
Check non_negative_number() {
  return Check([](const std::string& text) { return number(text) >= 0.0 ? "" : text + " must be >= 0"; });
}

Argument* Argument::required() {
  option_->required();
  return this;
}
Argument* Argument::type_name(const std::string& name) {
  option_->type_name(name);
  return this;
}
Argument* Argument::check(const Check& check) {
  option_->check(check.validator());
  return this;
}
Argument* Argument::expected(int values) {
  option_->expected(values);
  return this;
}
Argument* Argument::take_all() {
  option_->take_all();
  return this;
}
Argument* Argument::delimiter(char between) {
  option_->delimiter(between);
  return this;
}
Argument* Argument::allow_extra_args(bool allowed) {
  option_->allow_extra_args(allowed);
  return this;
}
Argument* Argument::excludes(const Argument* other) {
  option_->excludes(other->option_);
  return this;
}
Argument* Argument::needs(const Argument* other) {
  option_->needs(other->option_);
  return this;
}

}  // namespace loopwise::cli
