// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The command line as pages, one for each command: the contents of manual pages and of completion.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "command_line.hpp"

namespace loopwise::cli {

/// Possible values, by option ("--method") or name of a positional ("world"). A value that ends in '=' is
/// incomplete.
using ValueWords = std::map<std::string, std::vector<std::string>>;

/// The words with `between` between them.
[[nodiscard]] std::string join(const std::vector<std::string>& words, const std::string& between);

/// The kind of a value: a word of a list, a file or folder, or another value.
enum class ValueKind { kWords, kFile, kOther };

/// The documentation of an option or positional argument.
struct OptionPage {
  std::vector<std::string> names;  // "-o", "--output"; only its name for a positional
  std::string value;               // "DIR"; empty for a flag
  std::string text;                // including bounds
  bool required = false;
  bool repeated = false;
  std::vector<std::string> words;

  [[nodiscard]] ValueKind value_kind() const;
};

/// The documentation of a command and of its subcommands.
struct CommandPage {
  std::vector<std::string> path;  // "loopwise", "study", "ablation"
  std::string text;
  std::string notes;
  std::vector<OptionPage> positionals, options;
  std::vector<CommandPage> commands;

  /// The path with `by` between its words.
  [[nodiscard]] std::string joined(const std::string& by) const { return join(path, by); }
  /// Words for arguments without a name: subcommands, or the values of the first positional.
  [[nodiscard]] std::vector<std::string> plain_words() const;
};

/// The page of a program, from its options, commands and their texts.
[[nodiscard]] CommandPage program_page(const Command& program, const ValueWords& words);

}  // namespace loopwise::cli
