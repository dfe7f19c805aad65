// SPDX-License-Identifier: BSD-3-Clause
#include "command_line.hpp"

#include <algorithm>
#include <cstdint>

#include <CLI/CLI.hpp>

namespace loopwise::cli {

Command::Command(const std::string& text, const std::string& name)
    : owned_(std::make_unique<CLI::App>(text, name)), app_(owned_.get()) {
  app_->failure_message(CLI::FailureMessage::simple);
}
Command::Command(CLI::App* app) : app_(app) {}
Command::~Command() = default;

Command* Command::add_subcommand(const std::string& name, const std::string& text) {
  commands_.push_back(std::unique_ptr<Command>(new Command(app_->add_subcommand(name, text))));
  return commands_.back().get();
}

Argument* Command::added(CLI::Option* option) {
  return &arguments_.emplace_back(option);
}

template <class T>
Argument* Command::add_option(const std::string& names, T& value, const std::string& text) {
  return added(app_->add_option(names, value, text));
}
template <class T>
Argument* Command::add_option_function(const std::string& names, const std::function<void(const T&)>& use,
                                       const std::string& text) {
  return added(app_->add_option_function<T>(names, use, text));
}
Argument* Command::add_flag(const std::string& names, bool& value, const std::string& text) {
  return added(app_->add_flag(names, value, text));
}
void Command::set_version_flag(const std::string& names, const std::string& text) {
  app_->set_version_flag(names, text);
}

Argument* Command::get_option(const std::string& name) {
  const CLI::Option* const option = app_->get_option(name);
  const auto found = std::find_if(arguments_.begin(), arguments_.end(),
                                  [option](const Argument& argument) { return argument.option() == option; });
  return found != arguments_.end() ? &*found : added(app_->get_option(name));
}

void Command::footer(const std::string& text) {
  app_->footer(text);
}
void Command::hide() {
  app_->group("");
}
void Command::require_subcommand() {
  app_->require_subcommand(1);
}
void Command::callback(const std::function<void()>& action) {
  app_->callback(action);
}
bool Command::got_subcommand(const std::string& name) const {
  return app_->got_subcommand(name);
}

std::optional<int> Command::parse(int argc, char** argv) {
  try {
    app_->parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app_->exit(error);
  }
  return std::nullopt;
}

// Types of values on the command lines of the programs.
#define LOOPWISE_OPTION_TYPE(...) \
  template Argument* Command::add_option<__VA_ARGS__>(const std::string&, __VA_ARGS__&, const std::string&);
LOOPWISE_OPTION_TYPE(std::string)
LOOPWISE_OPTION_TYPE(int)
LOOPWISE_OPTION_TYPE(std::int64_t)
LOOPWISE_OPTION_TYPE(std::uint64_t)
LOOPWISE_OPTION_TYPE(double)
LOOPWISE_OPTION_TYPE(std::optional<std::string>)
LOOPWISE_OPTION_TYPE(std::optional<int>)
LOOPWISE_OPTION_TYPE(std::optional<std::int64_t>)
LOOPWISE_OPTION_TYPE(std::optional<std::uint64_t>)
LOOPWISE_OPTION_TYPE(std::optional<double>)
LOOPWISE_OPTION_TYPE(std::vector<std::string>)
LOOPWISE_OPTION_TYPE(std::vector<int>)
LOOPWISE_OPTION_TYPE(std::vector<std::int64_t>)
LOOPWISE_OPTION_TYPE(std::vector<double>)
#undef LOOPWISE_OPTION_TYPE
template Argument* Command::add_option_function<std::string>(const std::string&,
                                                             const std::function<void(const std::string&)>&,
                                                             const std::string&);
template Argument* Command::add_option_function<double>(const std::string&,
                                                        const std::function<void(const double&)>&,
                                                        const std::string&);

}  // namespace loopwise::cli
