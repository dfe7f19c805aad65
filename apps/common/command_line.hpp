// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options and commands of a program. CLI11 parses them, but only command_line.cpp and the files that
/// describe a whole command line include it: it is a large header without a compiled part.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace CLI {
class App;
class Option;
class Validator;
}  // namespace CLI

namespace loopwise::cli {

/// A condition on the text of a value.
class Check {
 public:
  /// \param refusal of a text: empty if the text is accepted, otherwise the error message
  explicit Check(const std::function<std::string(const std::string&)>& refusal);
  explicit Check(std::shared_ptr<const CLI::Validator> validator) : validator_(std::move(validator)) {}

  [[nodiscard]] const CLI::Validator& validator() const { return *validator_; }

 private:
  std::shared_ptr<const CLI::Validator> validator_;
};

/// A whole number within bounds, both included. Help texts name the bounds.
[[nodiscard]] Check in_range(int least, int most);
/// A number within bounds, both included.
[[nodiscard]] Check in_range(double least, double most);
[[nodiscard]] Check positive_number();
[[nodiscard]] Check non_negative_number();

/// An option or positional argument of a command, which owns it. Every member returns the argument itself.
class Argument {
 public:
  explicit Argument(CLI::Option* option) : option_(option) {}

  Argument* required();
  /// The word for the value in help texts.
  Argument* type_name(const std::string& name);
  Argument* check(const Check& check);
  /// Number of values for each use of the option.
  Argument* expected(int values);
  /// Keeps the values of all uses of the option.
  Argument* take_all();
  /// Separates several values in one word.
  Argument* delimiter(char between);
  Argument* allow_extra_args(bool allowed);
  Argument* excludes(const Argument* other);
  Argument* needs(const Argument* other);

  [[nodiscard]] CLI::Option* option() const { return option_; }

 private:
  CLI::Option* option_;
};

/// A command: its options, and commands below it.
class Command {
 public:
  /// The whole program.
  Command(const std::string& text, const std::string& name);
  ~Command();
  Command(const Command&) = delete;
  Command& operator=(const Command&) = delete;

  Command* add_subcommand(const std::string& name, const std::string& text);
  /// \param names as "-o,--output"; without dashes: a positional argument
  /// \param value a string, a number, an optional one, or a list of these; the types are listed in
  ///        command_line.cpp
  template <class T>
  Argument* add_option(const std::string& names, T& value, const std::string& text);
  /// Calls `use` with the value.
  template <class T>
  Argument* add_option_function(const std::string& names, const std::function<void(const T&)>& use,
                                const std::string& text);
  Argument* add_flag(const std::string& names, bool& value, const std::string& text);
  void set_version_flag(const std::string& names, const std::string& text);
  /// \throws std::exception if there is no such option
  [[nodiscard]] Argument* get_option(const std::string& name);

  /// Text below the options in the help.
  void footer(const std::string& text);
  /// The command is absent from help texts.
  void hide();
  void require_subcommand();
  /// Runs when the command line has been parsed and names this command.
  void callback(const std::function<void()>& action);
  /// Whether the parsed command line names this command below this one.
  [[nodiscard]] bool got_subcommand(const std::string& name) const;

  /// Parses the command line of a program, and prints help or an error if it asks for help or has one.
  /// \returns then the exit status of the parser, 0 for help
  [[nodiscard]] std::optional<int> parse(int argc, char** argv);

  [[nodiscard]] CLI::App& parser() const { return *app_; }

 private:
  explicit Command(CLI::App* app);
  Argument* added(CLI::Option* option);

  std::unique_ptr<CLI::App> owned_;  // of the program
  CLI::App* app_;
  std::vector<std::unique_ptr<Command>> commands_;
  std::deque<Argument> arguments_;
};

}  // namespace loopwise::cli
