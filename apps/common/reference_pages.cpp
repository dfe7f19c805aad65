// SPDX-License-Identifier: BSD-3-Clause
#include "reference_pages.hpp"

#include <algorithm>
#include <utility>

#include <CLI/CLI.hpp>

namespace loopwise::cli {
namespace {

/// Splits CLI11's type name: "N:INT in [0 - 4096]" is a name and bounds, "KEY[:M]" is only a name.
std::pair<std::string, std::string> name_and_bounds(const std::string& type) {
  int depth = 0;
  for (std::size_t i = 0; i < type.size(); ++i) {
    if (type[i] == '[') ++depth;
    if (type[i] == ']') --depth;
    if (type[i] == ':' && depth == 0) return {type.substr(0, i), type.substr(i + 1)};
  }
  return {type, ""};
}

std::string sentence(std::string text) {
  if (!text.empty() && text.back() != '.') text += '.';
  return text;
}

/// Whether a value with this type name may be a file or folder, by the names in use.
bool may_be_file(const std::string& value) {
  static const std::vector<std::string> no_files = {
      "B", "LIST", "M", "MB", "M_PER_M RAD_PER_M", "N", "NAME", "P", "R", "RAD", "S", "VALUE", "WORD"};
  return value.find_first_of("[=") == std::string::npos &&
         std::find(no_files.begin(), no_files.end(), value) == no_files.end();
}

OptionPage option_page(const CLI::Option& option, const ValueWords& words) {
  OptionPage page;
  if (option.get_positional()) {
    page.names.push_back(option.get_name(true));
  } else {
    for (const std::string& name : option.get_snames()) page.names.push_back("-" + name);
    for (const std::string& name : option.get_lnames()) page.names.push_back("--" + name);
  }
  page.required = option.get_required();
  page.text = sentence(option.get_description());
  if (option.get_items_expected_max() != 0) {  // not a flag
    const auto [name, bounds] = name_and_bounds(option.get_type_name());
    page.value = name.empty() ? "VALUE" : name;
    page.repeated = option.get_expected_max() >= CLI::detail::expected_max_vector_size;
    if (!bounds.empty()) page.text += " Value: " + sentence(bounds);
    if (!option.get_default_str().empty()) page.text += " Default: " + sentence(option.get_default_str());
  }
  // The value of --guess is a word for one command and a file for another.
  if (option.get_positional() || !may_be_file(page.value)) {
    for (const std::string& name : page.names) {
      const auto found = words.find(name);
      if (found != words.end()) page.words = found->second;
    }
  }
  return page;
}

CommandPage command_page(const CLI::App& app, const ValueWords& words, std::vector<std::string> path) {
  CommandPage page;
  path.push_back(app.get_name());
  page.path = std::move(path);
  page.text = app.get_description();
  // Commands without their own note inherit that of their parent.
  if (app.get_parent() == nullptr || app.get_footer() != app.get_parent()->get_footer()) {
    page.notes = app.get_footer();
  }
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;
    (option->get_positional() ? page.positionals : page.options).push_back(option_page(*option, words));
  }
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) {
    if (!command->get_group().empty()) page.commands.push_back(command_page(*command, words, page.path));
  }
  return page;
}

}  // namespace

std::string join(const std::vector<std::string>& words, const std::string& between) {
  std::string out;
  for (const std::string& word : words) out += (&word == &words.front() ? "" : between) + word;
  return out;
}

ValueKind OptionPage::value_kind() const {
  if (!words.empty()) return ValueKind::kWords;
  return may_be_file(value) ? ValueKind::kFile : ValueKind::kOther;
}

std::vector<std::string> CommandPage::plain_words() const {
  std::vector<std::string> names;
  for (const CommandPage& command : commands) names.push_back(command.path.back());
  return names.empty() && !positionals.empty() ? positionals[0].words : names;
}

CommandPage program_page(const Command& program, const ValueWords& words) {
  return command_page(program.parser(), words, {});
}

}  // namespace loopwise::cli
